"""The runner of the commands in the pages: how a block is marked, run, and found wrong."""

from __future__ import annotations

import os
import subprocess
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import pytest

from docs.commands import __main__ as command
from docs.commands.blocks import How, PageError, blocks_of, marker_of
from docs.commands.runner import InterruptedRunError, Page, Shared

CI = """
# make format
step "make setup" make setup
end_to_end() { make demo; }
"""


def _page(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "page.md"
    path.write_text(text, encoding="utf-8")
    return path


def _folder(path: Path) -> Path:
    path.mkdir()
    return path


def _blocks(tmp_path: Path, *marked: tuple[str, str]):
    text = "".join(
        f"{f'<!-- run: {marker} -->' if marker else ''}\n```bash\n{script}\n```\n\n"
        for marker, script in marked
    )
    return blocks_of(_page(tmp_path, text), "page.md")


def _outcomes(tmp_path: Path, *marked: tuple[str, str]):
    blocks = _blocks(tmp_path, *marked)
    logs, folder = tmp_path / "logs", tmp_path / "folder"
    logs.mkdir()
    folder.mkdir()
    with Page(folder, logs, dict(os.environ), CI, Shared()) as page:
        done = [page.run(block) for block in blocks]
        return done, list(page.finish())


@pytest.mark.parametrize(
    ("text", "how"),
    [
        ("no, needs a container engine", How.SKIP),
        ("where no-such-program", How.SKIP),
        ("where no-such-program: for 3 s", How.SKIP),
        ("where bash", How.RUN),
        ("where bash: for 3 s", How.FOR),
        ("by .ci/run", How.ELSEWHERE),
        ("for 3 s", How.FOR),
        ("each for 3 s", How.EACH),
        ('beside, until "ready"', How.BESIDE),
        ('beside, until "ready", exits 1, with --set a=1', How.BESIDE),
        ("with --duration 3", How.RUN),
        ("exits 1", How.RUN),
    ],
)
def test_markers(text, how):
    assert marker_of(text, "page.md:1").how is how


@pytest.mark.parametrize("text", ["no", "no, ", "maybe", "for a while", "beside", "exits"])
def test_a_marker_that_means_nothing_is_refused_with_its_place(text):
    with pytest.raises(PageError, match=r"^page.md:7: run: .*expected"):
        marker_of(text, "page.md:7")


def test_a_block_has_its_page_line_and_commands(tmp_path):
    text = "# Title\n\nText.\n\n```bash\none  # remark\n# remark\ntwo \\\n  --long\n```\n```python\nno\n```\n"
    (block,) = blocks_of(_page(tmp_path, text), "docs/page.md")
    assert block.place == "docs/page.md:5"
    assert [line.split() for line in block.lines] == [["one"], ["two", "--long"]]


def test_a_marker_belongs_to_the_block_right_after_it(tmp_path):
    text = "<!-- run: exits 1 -->\n\nText between.\n\n```bash\nfalse\n```\n"
    with pytest.raises(PageError, match=r"page.md:1: .*expected a block of commands after it"):
        blocks_of(_page(tmp_path, text), "page.md")


def test_what_is_run_for_a_time_is_one_command(tmp_path):
    with pytest.raises(PageError, match="2 commands: expected one"):
        _blocks(tmp_path, ("for 3 s", "one\ntwo"))


@pytest.mark.parametrize(
    "line", ["pip install .", "cd x && python3 -m pip install -e .", "uv pip install x"]
)
def test_nothing_is_installed_into_the_environment_that_runs_it(tmp_path, line):
    with pytest.raises(PageError, match="an environment of its own"):
        _blocks(tmp_path, ("", line))
    assert _blocks(tmp_path, ("", f".try/bin/{line.split('&& ')[-1]}"))
    assert _blocks(tmp_path, ("no, for users", line))


def test_blocks_share_a_folder_and_must_exit_with_0(tmp_path):
    done, _ = _outcomes(
        tmp_path, ("", "echo word > file"), ("", "grep word file"), ("", "grep no file\ntrue")
    )
    assert [bool(outcome.problem) for outcome in done] == [False, False, True]
    assert "exit code 1" in done[2].problem


def test_an_expected_exit_code_is_expected(tmp_path):
    done, _ = _outcomes(tmp_path, ("exits 3", "exit 3"), ("exits 3", "true"))
    assert [outcome.problem for outcome in done] == ["", "exit code 0: expected 3"]


def test_words_are_added(tmp_path):
    done, _ = _outcomes(tmp_path, ("with = 1", "test 1"), ("with = 2", "test 1"))
    assert [bool(outcome.problem) for outcome in done] == [False, True]


def test_a_skip_says_why(tmp_path):
    done, _ = _outcomes(tmp_path, ("no, needs a dish", "false"))
    assert (done[0].skipped, done[0].problem) == ("needs a dish", "")


def test_what_ci_runs_is_looked_up_there(tmp_path):
    done, _ = _outcomes(
        tmp_path, ("by .ci/run", "make setup\nmake demo  # flies"), ("by .ci/run", "make format")
    )
    assert done[0].skipped
    assert "make format" in done[1].problem


def test_ctrl_c_ends_what_runs_for_a_time(tmp_path):
    done, _ = _outcomes(tmp_path, ("for 1 s", "sleep 60"), ("each for 1 s", "sleep 60\nsleep 60"))
    assert [outcome.problem for outcome in done] == ["", ""]


def test_what_ends_too_early_is_found(tmp_path):
    done, _ = _outcomes(tmp_path, ("for 60 s", "true"))
    assert "ended before 60 s" in done[0].problem


def test_a_block_beside_goes_on_until_the_page_is_over(tmp_path):
    done, beside = _outcomes(
        tmp_path,
        ('beside, until "ready"', "touch up; echo ready; sleep 60"),
        ("", "test -e up"),
    )
    assert [outcome.problem for outcome in (*done, *beside)] == ["", "", ""]


def test_a_block_beside_that_fails_is_found_at_the_end(tmp_path):
    _, beside = _outcomes(tmp_path, ('beside, until "ready"', "echo ready; exit 4"), ("", "true"))
    assert "exit code 4" in beside[0].problem


def test_a_block_beside_may_end_with_a_code_of_its_own_or_at_ctrl_c(tmp_path):
    """A flight that `ptnsbc stop` ends is not met; whether it has ended when the page is over is chance."""
    for end, problem in (("exit 1", ""), ("exit 4", "exit code 4"), ("sleep 60", "")):
        folder = tmp_path / end.replace(" ", "_")
        folder.mkdir()
        _, beside = _outcomes(
            folder, ('beside, until "ready", exits 1', f"echo ready; {end}"), ("", "sleep 0.3")
        )
        assert bool(beside[0].problem) == bool(problem), beside
        assert problem in beside[0].problem


def test_a_block_beside_that_never_says_it_is_found(tmp_path):
    done, beside = _outcomes(tmp_path, ('beside, until "ready"', "echo other"))
    assert "did not say 'ready'" in done[0].problem
    assert not beside


def test_nothing_goes_on_when_the_run_of_all_pages_is_over(tmp_path):
    shared = Shared()
    shared.over.set()
    (block,) = _blocks(tmp_path, ("", "sleep 60"))
    with (
        pytest.raises(InterruptedRunError),
        Page(tmp_path, _folder(tmp_path / "logs"), dict(os.environ), CI, shared) as page,
    ):
        page.run(block)


def _page_beside(tmp_path: Path, shared: Shared, name: str) -> Page:
    return Page(tmp_path, _folder(tmp_path / name), dict(os.environ), CI, shared)


def test_a_page_with_vehicles_has_the_machine_alone_until_it_is_over(tmp_path):
    shared = Shared()
    vehicles = _blocks(tmp_path, ("", ": ptnsbc autopilot"), ("", ": ptnsbc autopilot again"))
    (other,) = _blocks(tmp_path, ("", "touch other"))
    with ThreadPoolExecutor(1) as pool, _page_beside(tmp_path, shared, "b") as page_beside:
        with _page_beside(tmp_path, shared, "a") as page:
            assert [page.run(block).problem for block in vehicles] == ["", ""]
            waiting = pool.submit(page_beside.run, other)
            assert not wait([waiting], 0.3).done
            assert not (tmp_path / "other").exists()
        assert waiting.result(60).problem == ""
    assert (tmp_path / "other").exists()


def test_a_page_with_vehicles_waits_for_what_goes_on_beside_another(tmp_path):
    shared = Shared()
    (vehicles,) = _blocks(tmp_path, ("", ": ptnsbc autopilot"))
    blocks = _blocks(tmp_path, ('beside, until "up"', "echo up; sleep 60"), ("", "true"))
    with ThreadPoolExecutor(1) as pool, _page_beside(tmp_path, shared, "b") as page_beside:
        with _page_beside(tmp_path, shared, "a") as page:
            assert page.run(blocks[0]).problem == ""
            waiting = pool.submit(page_beside.run, vehicles)
            assert page.run(blocks[1]).problem == ""
            assert not wait([waiting], 0.3).done
            assert [outcome.problem for outcome in page.finish()] == [""]
        assert waiting.result(60).problem == ""


def test_pages_run_at_the_same_time_and_are_printed_in_their_order(tmp_path, capsys, monkeypatch):
    up, down = tmp_path / "up", tmp_path / "down"
    root = _folder(tmp_path / "root")
    (_folder(root / ".ci") / "run").write_text(CI, encoding="utf-8")
    first = f"touch {up}\nuntil [ -e {down} ]; do sleep 0.01; done"
    second = f"until [ -e {up} ]; do sleep 0.01; done\necho $ROS_DOMAIN_ID > {down}"
    for name, script in (("a.md", first), ("b.md", second), ("c.md", "ptnsbc-none --domain 42")):
        (root / name).write_text(f"```bash\n{script}\n```\n", encoding="utf-8")
    subprocess.run(["git", "init", "--quiet"], cwd=root, check=True)
    monkeypatch.setattr(command, "ROOT", root)
    monkeypatch.setattr(command, "_DOMAIN_IS_GIVEN", False)
    monkeypatch.setattr(command, "_compile_laws", lambda: None)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert command.main(["a.md", "b.md", "c.md", "--jobs", "2"]) == 1
    told = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in told if ".md:" in line] == [
        ["a.md:1", "ok"],
        ["b.md:1", "ok"],
        ["c.md:1", "FAILED"],
    ]
    assert int(down.read_text()) in range(1, 102)


def test_the_pages_of_the_repository_can_be_run(capsys):
    assert command.main(["--list"]) == 0
    told = capsys.readouterr().out
    assert "README.md" in told.splitlines()[0]
    assert "docs/bags.md" in told


def test_a_bad_page_is_refused_in_one_line(tmp_path, capsys, monkeypatch):
    _page(tmp_path, "<!-- run: perhaps -->\n```bash\ntrue\n```\n")
    monkeypatch.setattr(command, "ROOT", tmp_path)
    assert command.main(["page.md"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
