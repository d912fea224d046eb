"""`python -m docs.make.site [-o FOLDER]`: every page of the repository as a site that is searched without a network.

The pages are those of the repository, unchanged: they are copied with their folders, so that every link between them
and to a file of the repository stays what it is. MkDocs then fails for a link that leads nowhere.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import yaml
from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[2]
WORKER = "assets/iframe-worker.js"
INDEX = ROOT / "docs" / "README.md"
_LINKS = {"a": "href", "img": "src"}


def pages() -> list[Path]:
    """Every page of the repository."""
    words = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"]
    found = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    return [ROOT / name for name in found.stdout.split() if (ROOT / name).is_file()]


def links(page: Path) -> Iterator[str]:
    """The targets of all links and pictures of a page that are files."""
    tokens = MarkdownIt("commonmark").enable("table").parse(page.read_text(encoding="utf-8"))
    for token in tokens:
        for child in token.children or ():
            target = str(child.attrs.get(_LINKS.get(child.tag, ""), ""))
            parts = urlsplit(target)
            if parts.path and not parts.scheme:
                yield unquote(parts.path)


def groups() -> list[dict[str, Any]]:
    """The navigation: the table of docs/README.md, one group for each bold row."""
    found: list[dict[str, Any]] = [{"Home": "README.md"}, {"All pages": "docs/README.md"}]
    tokens = MarkdownIt("commonmark").enable("table").parse(INDEX.read_text(encoding="utf-8"))
    inside: list[str | dict[str, str]] = []
    for token in tokens:
        children = token.children or []
        if [child.type for child in children[:1]] == ["strong_open"] or (
            len(children) > 1 and children[1].type == "strong_open"
        ):
            inside = []
            found.append({token.content.strip("*"): inside})
        for child in children:
            target = str(child.attrs.get("href", ""))
            if child.type == "link_open" and target.endswith(".md"):
                place = (INDEX.parent / target).resolve().relative_to(ROOT)
                if not any(place.as_posix() in str(one) for one in inside):
                    inside.append(place.as_posix())
    return found


def stage(folder: Path) -> None:
    """Copy every page, and every file that one links to, into a folder with the tree of the repository."""
    for page in pages():
        files = [page, *((page.parent / link).resolve() for link in links(page))]
        for file in files:
            if file.is_file() and file.is_relative_to(ROOT):
                place = folder / file.relative_to(ROOT)
                place.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, place)


def settings(source: Path, output: Path) -> dict[str, Any]:
    """The settings in mkdocs.yml."""
    return {
        "site_name": "PTNSBC",
        "site_description": "Predefined-time formations of UAVs on ROS 2 Jazzy",
        "docs_dir": str(source),
        "site_dir": str(output),
        "strict": True,
        "use_directory_urls": False,
        "nav": groups(),
        "theme": {
            "name": "material",
            "font": False,
            "features": ["navigation.indexes", "navigation.tabs", "navigation.top", "toc.follow"],
            "palette": [
                {"media": "(prefers-color-scheme: light)", "scheme": "default"},
                {"media": "(prefers-color-scheme: dark)", "scheme": "slate"},
            ],
        },
        "plugins": ["search", "offline"],
        # In the place of a script that the theme would fetch from elsewhere.
        "extra": {"generator": False, "polyfills": [WORKER]},
        "markdown_extensions": [
            "tables",
            "admonition",
            "attr_list",
            "pymdownx.superfences",
            "pymdownx.highlight",
            {"toc": {"permalink": True, "slugify": "@slugify@"}},
        ],
        "validation": {
            "nav": {"omitted_files": "ignore", "not_found": "warn"},
            "links": {"not_found": "warn", "anchors": "warn", "unrecognized_links": "warn"},
        },
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Build; MkDocs's exit code."""
    parser = argparse.ArgumentParser(prog="python -m docs.make.site", description="Build the site.")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build" / "site")
    output = parser.parse_args(arguments).output.resolve()
    with tempfile.TemporaryDirectory(prefix="ptnsbc-site-") as name:
        source, config = Path(name) / "pages", Path(name) / "mkdocs.yml"
        stage(source)
        (source / WORKER).parent.mkdir()
        shutil.copyfile(Path(__file__).with_name("offline_worker.js"), source / WORKER)
        text = yaml.safe_dump(settings(source, output), sort_keys=False)
        # As GitHub makes them, so that a link is right in both places.
        slugs = "!!python/object/apply:pymdownx.slugs.slugify {kwds: {case: lower}}"
        config.write_text(text.replace("'@slugify@'", slugs), encoding="utf-8")
        build = ["build", "--strict", "--config-file", str(config)]
        quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
        code = subprocess.run([sys.executable, "-m", "mkdocs", *build], env=quiet).returncode
    if code == 0:
        print(f"{output / 'index.html'}: {sum(1 for _ in output.rglob('*.html'))} pages")
    return code


if __name__ == "__main__":
    sys.exit(main())
