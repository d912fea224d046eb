"""Make the pictures of the report: `python docs/img/make_report.py`.

report.png is the one in README, report_20.png that of 20 UAVs, report_print.png the pages of the first as printed. It
flies both; `python docs/img/make_report.py BAG BAG20` takes bags that are there. Needs Chromium, the extra [dev], and
`pip install pypdfium2`, which draws the printed pages.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pypdfium2
from PIL import Image
from playwright.sync_api import sync_playwright

SIZE = {"width": 1280, "height": 1200}
TIME_S = 20.5  # two UAVs keep clear of an obstacle
FLIGHTS = (("paper_5",), ("paper_20", "--duration", "14"))
PAGE_WIDTH = 420  # of a printed page in the picture [pixels]
IN_A_ROW = 4
GAP = 8  # between printed pages [pixels]
HERE = Path(__file__).parent


def main(bags: list[Path]) -> None:
    """Take the pictures."""
    with tempfile.TemporaryDirectory() as folder_name:
        folder = Path(folder_name)
        bag, many = bags or [flown(folder, flight) for flight in FLIGHTS]
        with sync_playwright() as driver:
            browser = driver.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--no-sandbox"]
            )
            tab = opened(browser, bag, folder)
            save(Image.open(io.BytesIO(tab.screenshot())), HERE / "report.png")
            save(printed(tab), HERE / "report_print.png")
            tab = opened(browser, many, folder)
            save(Image.open(io.BytesIO(tab.screenshot())), HERE / "report_20.png")
            browser.close()


def flown(folder: Path, flight: tuple[str, ...]) -> Path:
    """The bag of a headless flight: its scenario, and options."""
    bag = folder / flight[0]
    words = ["simulate", *flight, "--bag", str(bag)]
    subprocess.run([sys.executable, "-m", "ptnsbc_tools", *words], check=True)
    return bag


def opened(browser: Any, bag: Path, folder: Path) -> Any:
    """The report of a bag in the browser, at TIME_S, with all its figures."""
    page = folder / f"{bag.name}-report"
    report = [sys.executable, "-m", "ptnsbc_tools", "report", str(bag), "-o", str(page)]
    subprocess.run([*report, "--no-pictures"], check=True)
    tab = browser.new_page(viewport=SIZE, color_scheme="light")
    tab.goto((page / "index.html").as_uri())
    tab.wait_for_selector("html[data-ready=true]")
    tab.evaluate("page.views.follow()")
    tab.evaluate(f"page.clock.seek({TIME_S})")
    tab.wait_for_function("() => page.figures.charts.every((one) => one.drawn)")
    tab.wait_for_function("() => page.scene.poses && !page.scene.due")
    return tab


def printed(tab: Any) -> Image.Image:
    """The pages that are printed on A4, in rows."""
    document = pypdfium2.PdfDocument(tab.pdf(format="A4", prefer_css_page_size=True))
    scale = PAGE_WIDTH / document[0].get_width()
    pages = [page.render(scale=scale).to_pil() for page in document]
    wide, high = pages[0].width + GAP, pages[0].height + GAP
    rows = -(-len(pages) // IN_A_ROW)
    sheet = Image.new("RGB", (wide * IN_A_ROW + GAP, high * rows + GAP), "#8c96a5")
    for k, page in enumerate(pages):
        sheet.paste(page, (GAP + wide * (k % IN_A_ROW), GAP + high * (k // IN_A_ROW)))
    return sheet


def save(picture: Image.Image, path: Path) -> None:
    """A picture of 256 colours: a third of the bytes."""
    few = picture.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1)
    few.save(path, optimize=True)
    print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:3]])
