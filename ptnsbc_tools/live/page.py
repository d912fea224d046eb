"""The page of the live view: the parts of the report's page, fed over a socket."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from string import Template

from ptnsbc_tools.report.page import asset, plotly

_SCRIPTS = ("data.js", "clock.js", "camera.js", "scene.js", "charts.js", "main.js")


@cache
def live_page() -> str:
    """The whole page; what it shows comes over its socket."""
    own = files(__package__).joinpath("assets")
    scripts = [*map(asset, _SCRIPTS), own.joinpath("live.js").read_text("utf-8")]
    return Template(own.joinpath("live.html").read_text("utf-8")).substitute(
        view=asset("view.html"),
        style=asset("style.css") + own.joinpath("live.css").read_text("utf-8"),
        script="\n".join(scripts),
        plotly=plotly(),
    )
