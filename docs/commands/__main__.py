"""`python -m docs.commands [PAGE]...`: run every ```bash block of the pages in a scratch clone.

Each page has a clone and a ROS domain of its own, in which its blocks run in order; each block is a shell of its own.
The clone has no `.venv`: the environment that runs this must not be within reach of what a page installs. Several pages
run at the same time, those with the most commands first. From its first block with vehicles a page has the machine
alone: they fly in real time. The results are printed in the order of the pages.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

from docs.commands.blocks import NOT_RUN, Block, PageError, blocks_of
from docs.commands.runner import Outcome, Page, Shared
from ptnsbc_nodes.runtime.environment import reserved_domain

ROOT = Path(__file__).resolve().parents[2]
_DOMAIN = re.compile(r"(?:--domain |ROS_DOMAIN_ID=)(\d+)")
_DOMAIN_IS_GIVEN = "ROS_DOMAIN_ID" in os.environ
_LEFT_OUT = ("CHANGELOG.md",)  # tells of commands that were


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when every block did what its page says, 1 when one did not, 2 for a bad page."""
    options = _parser().parse_args(arguments)
    if (
        signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    ):  # as for `make commands &`: the shells would inherit it
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        pages = {name: blocks_of(ROOT / name, name) for name in options.pages or _pages()}
    except (PageError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if options.list:
        for block in (block for blocks in pages.values() for block in blocks):
            print(f"{block.place}: {block.marker.how.value}: {'; '.join(block.lines)}")
        return 0
    began = time.monotonic()
    _compile_laws()
    done = [_printed(outcome) for outcome in _outcomes(pages, options.jobs)]
    return _print_summary(done, time.monotonic() - began)


def _pages() -> list[str]:
    """Every page in the repository, the README first."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"]
    found = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    names = [name for name in found.split() if name not in _LEFT_OUT]
    return sorted(names, key=lambda name: (name != "README.md", name))


def _compile_laws() -> None:
    """Pages that begin at the same time find the laws compiled."""
    flight = ["-m", "ptnsbc_tools", "simulate", "paper_5", "--duration", "0.1"]
    subprocess.run([sys.executable, *flight], cwd=ROOT, check=False, capture_output=True)


def _outcomes(pages: Mapping[str, Sequence[Block]], jobs: int) -> Iterator[Outcome]:
    """The outcome of every block, page by page; at Ctrl-C every page ends its processes."""
    shared = Shared()
    scripts = "\n".join(block.script for blocks in pages.values() for block in blocks)
    named = () if _DOMAIN_IS_GIVEN else {int(number) for number in _DOMAIN.findall(scripts)}
    longest_first = sorted(pages, key=lambda name: -_commands_in(pages[name]))
    with ThreadPoolExecutor(jobs) as pool:
        running = {name: pool.submit(_run, pages[name], shared, named) for name in longest_first}
        try:
            for name in pages:
                yield from running[name].result()
        finally:
            shared.over.set()
            pool.shutdown(cancel_futures=True)


def _commands_in(blocks: Sequence[Block]) -> int:
    return sum(len(block.lines) for block in blocks if block.marker.how not in NOT_RUN)


def _run(blocks: Sequence[Block], shared: Shared, named: Collection[int]) -> list[Outcome]:
    if not blocks:
        return []
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="ptnsbc-docs-")))
        while (domain := stack.enter_context(reserved_domain())) in named:
            continue  # it belongs to the page that names it
        folder, logs = scratch / "ptnsbc", scratch / "logs"
        logs.mkdir()
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(folder)], check=True)
        page = stack.enter_context(Page(folder, logs, _environment(domain), ci, shared))
        return [*(page.run(block) for block in blocks), *page.finish()]


def _environment(domain: int) -> dict[str, str]:
    """As after `make setup` and with .venv activated, on a ROS domain of the page."""
    changed = {
        "PATH": os.pathsep.join((str(Path(sys.prefix) / "bin"), os.environ.get("PATH", ""))),
        "VIRTUAL_ENV": sys.prefix,
        # The laws of this checkout, which are compiled already; the clone's are the same.
        "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH")))),
        # ... and not the clone's: `python -m` looks in the current folder first. (From Python 3.11 on.)
        "PYTHONSAFEPATH": "1",
        "ROS_DOMAIN_ID": str(domain),
    }
    return {**os.environ, **changed}


def _printed(outcome: Outcome) -> Outcome:
    first = outcome.block.lines[0] if outcome.block.lines else ""
    if outcome.skipped:
        what = f"not run   {outcome.skipped}: {first}"
    elif outcome.problem:
        what = f"FAILED    {outcome.took_s:5.1f} s  {outcome.problem}: {first}"
    else:
        what = f"ok        {outcome.took_s:5.1f} s  {first}"
    print(f"{outcome.block.place:24} {what}", flush=True)
    if outcome.output:
        print("    " + outcome.output.replace("\n", "\n    "), flush=True)
    return outcome


def _print_summary(done: Sequence[Outcome], seconds: float) -> int:
    failed = [outcome.block.place for outcome in done if outcome.problem]
    blocks = {outcome.block.place for outcome in done}
    skipped = {outcome.block.place for outcome in done if outcome.skipped}
    print(f"{len(blocks)} blocks in {seconds:.0f} s: {len(skipped)} not run, {len(failed)} failed")
    for place in failed:
        print(f"failed: {place}", file=sys.stderr)
    return int(bool(failed))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m docs.commands", description="Run every command block of the pages."
    )
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="as docs/bags.md; by default all")
    parser.add_argument(
        "--jobs",
        type=int,
        choices=range(1, 65),
        # Pages in one domain would hear each other. One more than cores: flights in real time wait.
        default=1 if _DOMAIN_IS_GIVEN else len(os.sched_getaffinity(0)) + 1,
        metavar="N",
        help="pages at the same time; by default one more than cores, one where ROS_DOMAIN_ID is set",
    )
    parser.add_argument(
        "--list", action="store_true", help="print how each block is run, and run none"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
