"""The documentation: links lead somewhere, as plain files and as a site; the site is whole and fetches nothing."""

import re
import subprocess
import sys

import make_gallery
import pytest
from launch import ROOT

from pmpm.scene.files import builtin_scenes

PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "jobs" / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"`[^`\n]*`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
FETCHED = re.compile(r'<(?:script|link|img|source|iframe)\b[^>]*(?:src|href)="(https?:)?//')


def text_of(page):
    return page.read_text(encoding="utf-8")


def links_of(page):
    """What a page links to, but for code and addresses."""
    return [link for link in LINK.findall(CODE.sub("", FENCE.sub("", text_of(page)))) if "://" not in link]


def anchors_of(page):
    """Anchors of a page's headings, as code hosts make them."""
    found = []
    for heading in HEADING.findall(FENCE.sub("", text_of(page))):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").replace("\\", "")
        anchor = re.sub(r"[^\w\- ]", "", words.strip().lower()).replace(" ", "-")
        found.append(anchor if anchor not in found else f"{anchor}-{found.count(anchor)}")
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_a_page_read_as_a_plain_file_leads_somewhere(page):
    for link in links_of(page):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors_of(target), link


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built as its readers get it; a warning is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return folder


def test_the_site_has_every_page(site):
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").with_suffix(".html")
        assert (site / (name if name.stem != "README" else name.with_name("index.html"))).exists(), name
    assert (site / "changes.html").exists()
    assert (site / "jobs.html").exists()
    assert not list(site.rglob("*.py"))


def test_the_site_fetches_nothing_from_elsewhere(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 50
    assert [page.name for page in pages if FETCHED.search(text_of(page))] == []


def test_formulas_need_no_script(site):
    theory = text_of(site / "theory.html")
    assert theory.count("<math") > 100
    assert "arithmatex" not in theory
    assert r"\frac" not in theory


def test_the_page_of_python_has_every_public_name_with_its_docstring(site):
    import pmpm

    page = text_of(site / "api.html")
    for name in pmpm.__all__:
        assert re.search(rf"<h[23][^>]*>(?:\s|<[^>]*>)*{name}\b", page), name
    assert "Advance by one time step." in page


def test_the_gallery_is_what_the_scenes_say():
    assert text_of(ROOT / "docs" / "gallery.md") == make_gallery.page(), "run python docs/make_gallery.py --text"


@pytest.mark.parametrize("name", builtin_scenes())
def test_a_built_in_scene_has_a_small_picture(name):
    picture = ROOT / "docs" / "pictures" / "gallery" / f"{name}.png"
    assert picture.exists(), f"run python docs/make_gallery.py {name}"
    assert 0 < picture.stat().st_size <= make_gallery.LARGEST


def test_the_gallery_shows_nothing_that_is_gone():
    names = set(builtin_scenes())
    assert set(make_gallery.SHOWN) <= names
    assert {picture.stem for picture in (ROOT / "docs" / "pictures" / "gallery").iterdir()} <= names
