"""What MkDocs asks while it builds the site: pages that lie outside docs/, links to files that are no pages, and formulas.

The pages are written to be read as plain files on a code host as well: there a link may lead to any file of the repository.
"""

import html
import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
FROM_ELSEWHERE = {
    "jobs.md": "jobs/README.md",
    "changes.md": "CHANGELOG.md",
}  # page of the site -> file of the repository
LINK = re.compile(r"\[([^\]\n]*(?:\n[^\]\n]*)?)\]\(([^)\s]+)\)")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files, config):
    """Take the pages that lie outside docs/ into the site."""
    for page, file in FROM_ELSEWHERE.items():
        files.append(File.generated(config, page, content=(ROOT / file).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown, page, config, files):
    """Lead links that leave docs/ to the page of the site, or say the file's name where there is none."""
    home = posixpath.dirname(FROM_ELSEWHERE.get(page.file.src_uri, f"docs/{page.file.src_uri}"))

    def led(found):
        text, target = found.groups()
        path, sign, anchor = target.partition("#")
        if "://" in target or not path:
            return found.group()
        file = posixpath.normpath(posixpath.join(home, path))
        pages = {file: page for page, file in FROM_ELSEWHERE.items()}
        if file in pages or page.file.src_uri in FROM_ELSEWHERE:
            inside = pages.get(file, file.removeprefix("docs/"))
            return f"[{text}]({posixpath.relpath(inside, posixpath.dirname(page.file.src_uri) or '.')}{sign}{anchor})"
        if file.startswith("docs/") and not file.endswith(".py"):
            return found.group()
        if not (ROOT / file).exists():
            raise FileNotFoundError(f"{home}: {target} leads nowhere")
        return text if text.startswith("`") or "." in text else f"{text} (`{file}`)"

    return LINK.sub(led, markdown)


def on_page_content(content, page, config, files):
    """Turn formulas into MathML, which browsers draw by themselves."""
    from latex2mathml.converter import convert

    def formula(found):
        return convert(html.unescape(found.group(3)), display="block" if found.group(2) == "[" else "inline")

    return FORMULA.sub(formula, content)
