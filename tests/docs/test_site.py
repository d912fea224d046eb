"""The site of all pages: it builds strictly, asks no other computer for anything, and is searched offline."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from chromium import chromium

pytest.importorskip("mkdocs", reason="needs mkdocs-material: make setup-site")

from docs.make import site

pytestmark = pytest.mark.slow

# What a page loads, in contrast to where its links lead.
_LOADED = re.compile(r"<(?:script|link|img|iframe)[^>]+(?:src|href)=[\"']?(https?://[^\"'> ]+)")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    assert site.main(["-o", str(folder)]) == 0
    return folder


def test_every_page_is_there_and_loads_nothing_from_elsewhere(built: Path) -> None:
    for page in site.pages():
        place = page.relative_to(site.ROOT).with_suffix(".html")
        place = place.with_name("index.html") if page.name == "README.md" else place
        text = (built / place).read_text(encoding="utf-8")
        assert [found for found in _LOADED.findall(text) if "ptnsbc" not in found] == []


def test_it_is_searched_without_a_network(built: Path) -> None:
    with chromium() as browser:
        context = browser.new_context(viewport={"width": 1280, "height": 900})
        context.set_offline(True)
        page = context.new_page()
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto((built / "index.html").as_uri())
        page.locator("input.md-search__input").click()
        page.wait_for_function(
            "() => !['', 'Initializing search'].includes("
            "document.querySelector('.md-search-result__meta').textContent.trim())"
        )
        page.locator("input.md-search__input").press_sequentially("null space")
        found = page.locator("a.md-search-result__link").first
        found.wait_for()
        assert ".html" in found.get_attribute("href")
    assert [one for one in asked if not one.startswith("file:")] == []


def test_the_index_of_the_search_has_the_headings(built: Path) -> None:
    index = (built / "search" / "search_index.js").read_text(encoding="utf-8")
    assert "predefined" in index and "docs/method.html#slots" in index


def test_every_page_of_the_index_is_in_the_navigation() -> None:
    named = str(site.groups())
    pages = [page.name for page in (site.ROOT / "docs").glob("*.md")]
    assert [name for name in pages if name not in named] == []


def test_a_link_that_leads_nowhere_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    links = ["gone.md", "method.md#no-such-heading", "../gone/file.py"]
    for name, text in {
        "README.md": "# Home\n",
        "docs/README.md": "# Pages\n\n| Page | |\n|---|---|\n| [method.md](method.md) | it |\n",
        "docs/method.md": "# Method\n\n" + " ".join(f"[somewhere]({link})" for link in links),
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.setattr(site, "ROOT", tmp_path)
    monkeypatch.setattr(site, "INDEX", tmp_path / "docs" / "README.md")
    monkeypatch.setattr(site, "pages", lambda: sorted(tmp_path.rglob("*.md")))
    assert site.main(["-o", str(tmp_path / "site")]) != 0
    err = capfd.readouterr().err
    assert [link for link in links if (link.partition("#")[2] or link) not in err] == []
