"""Pages of results: docs/results/NAME.md."""


def write(docs, name, text):
    """Write such a page; the folder is made if there is none yet."""
    (docs / "results").mkdir(parents=True, exist_ok=True)
    (docs / "results" / f"{name}.md").write_text(text, encoding="utf-8")
