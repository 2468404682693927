"""The real application with its window: F12, Esc, panels, Compare and random renders, as a person does them.

Needs Blender itself, not the module: `$BLENDER` (a command, such as "real_blender run") or `blender` on the path; Xvfb,
xdotool and ImageMagick for screen, keys and pictures. By hand, with many renders and pictures in out/real:

    RTGI_WINDOW_RENDERS=200 BLENDER="real_blender run" python -m pytest tests/real
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
RENDERS = max(int(os.environ.get("RTGI_WINDOW_RENDERS", "5")), 2)
DRIVER_WORDS = shlex.split(os.environ.get("RTGI_WINDOW_WORDS", ""))      # such as --scene glossy_hall --open-panels
# what a growing render leaves behind is far above this: a Cycles session is 270 MB
GROWTH_MB = 100.0


def blender_command() -> list[str]:
    """The command that starts Blender, [] where there is none."""
    named = os.environ.get("BLENDER") or shutil.which("blender") or ""
    return shlex.split(named)


def grant(wish: Path) -> None:
    """Press the key or take the picture that the driver waits for, on the display that it names."""
    what = json.loads(wish.read_text())
    if "key" in what:
        words = ["xdotool", "mousemove", "500", "400", "key", what["key"]]
    else:
        words = ["import", "-window", "root", str(wish.with_name(what["picture"] + ".png"))]
    subprocess.run(words, env={**os.environ, "DISPLAY": what["display"]}, check=True, timeout=60)
    wish.unlink()


@contextlib.contextmanager
def screen() -> Iterator[str]:
    """A virtual screen of its own, so that no key lands on a person's desktop."""
    read, write = os.pipe()
    server = subprocess.Popen(["Xvfb", "-displayfd", str(write), "-screen", "0", "1600x1000x24"], pass_fds=[write],
                              stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(write)
    try:
        with os.fdopen(read) as number:
            yield f":{number.readline().strip()}"
    finally:
        server.terminate()
        server.wait()


@pytest.fixture(scope="module")
def seen() -> dict:
    """What the driver saw. The folder is inside the checkout, since a Blender in a container may see nothing else."""
    command = blender_command()
    if not command:
        pytest.skip("there is no Blender with a window here: set $BLENDER or put blender on the path")
    missing = [tool for tool in ("Xvfb", "xdotool", "import") if not shutil.which(tool)]
    if missing:
        pytest.skip(f"no screen, keys or pictures for Blender's window without {', '.join(missing)}")
    out = ROOT / "out" / "real"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    words = [*command, "--window-geometry", "0", "0", "1600", "1000", "--python-exit-code", "1",
             "--python", "tests/real/drive.py", "--", "-o", "out/real", "--renders", str(RENDERS), *DRIVER_WORDS]
    with (out / "log.txt").open("wb") as log, screen() as display:
        # a session of its own: the command may be a script with children, and all of it ends here
        process = subprocess.Popen(words, cwd=ROOT, env={**os.environ, "DISPLAY": display}, stdout=log,
                                   stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, start_new_session=True)
        limit = time.monotonic() + 900 + 20 * RENDERS
        try:
            while process.poll() is None and time.monotonic() < limit:
                for wish in out.glob("*.wish"):
                    grant(wish)
                time.sleep(0.05)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
                process.wait()
    assert (out / "seen.json").is_file(), (out / "log.txt").read_text(errors="replace")[-3000:]
    found = json.loads((out / "seen.json").read_text())
    assert "error" not in found, found["error"]
    return found


def test_f12_gives_a_picture(seen):
    assert seen["renders"][0]["end"] == "complete" and seen["mean"] > 0.01


def test_escape_cancels_a_render(seen):
    (cancelled,) = [render for render in seen["renders"] if render["name"] == "cancelled render"]
    assert cancelled["end"] == "cancel"


def test_undo_takes_back_a_toggle_and_the_next_render_is_well(seen):
    assert seen["undo"]
    assert [render["end"] for render in seen["renders"] if render["name"] == "after undo"] == ["complete"]


def test_escape_stops_a_comparison(seen):
    assert seen["stopped"]


def test_comparison_ends_in_a_table(seen):
    assert seen["compare_exit"] == 0, seen["compare_log"]
    rows = [row[0] for row in seen["comparison"]]
    assert rows[0] == "RTGI" and "Direct only" in rows


def test_window_stays_awake_during_a_comparison(seen):
    # drawing and the saved copy take their time on a loaded machine; a blocked window would miss minutes
    assert seen["gaps_s"]["comparison"] < 5.0


def test_random_toggles_and_renders_end_well(seen):
    random = [render for render in seen["renders"] if render["name"].startswith("random")]
    assert len(random) == RENDERS and {render["end"] for render in random} <= {"complete", "cancel"}


def test_memory_does_not_grow_from_render_to_render(seen):
    memory = np.array(seen["memory_mb"][-RENDERS:])
    half = RENDERS // 2
    assert memory[-half:].mean() - memory[:half].mean() < GROWTH_MB
