"""What a second Blender does for the window: comparison, warm-up, and how they end."""

import time
from pathlib import Path

import numpy as np
import pytest

from rtgi_addon.core.techniques import optional_techniques

pytestmark = pytest.mark.blender


@pytest.fixture
def tasks(bpy_session):
    from rtgi_addon.ui import tasks

    yield tasks
    tasks.stop()


@pytest.fixture
def compared(bpy_session, small_scene, tasks):
    """The small scene, never saved, compared at one sample with RSM alone."""
    for name in optional_techniques():
        setattr(small_scene.rtgi, f"use_{name}", name == "rsm")
    bpy_session.ops.rtgi.compare(samples=1)
    return tasks.last_comparison()


def test_comparison_gives_a_table_a_picture_and_a_reference_for_the_next(bpy_session, compared, tasks):
    rows = {row[0]: row[1:] for row in compared.rows}
    assert {"RTGI", "Direct only", "RSM", "Cycles' noise"} <= set(rows)
    assert rows["RTGI"][0].endswith(" s") and rows["RTGI"][2].endswith(" %") and float(rows["RTGI"][3]) > 0
    assert rows["Direct only"][1] == "100 %"   # no bounce at all
    image = bpy_session.data.images["RTGI Compare"]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    assert image.size[0] > 3 * 64 and image.size[1] > 36 and pixels.std() > 0.05
    assert Path(compared.reference).is_file()
    assert not list(Path(compared.picture).parent.glob("*.blend"))     # the copy of the file is gone
    earlier = compared.reference
    bpy_session.ops.rtgi.compare(samples=1, reference=earlier)
    assert tasks.last_comparison().reference == earlier and Path(earlier).is_file()
    bpy_session.ops.rtgi.compare(samples=1)      # one with a reference of its own: nothing of the others is needed
    assert not Path(earlier).exists() and Path(tasks.last_comparison().reference).is_file()


def test_a_reference_of_the_users_own_is_never_removed(tasks, tmp_path):
    reference = tmp_path / "references" / "mine.npz"
    reference.parent.mkdir()
    reference.write_bytes(b"")
    assert tasks.Comparison("", (), str(tmp_path / "compare.png"), str(reference)).folders == set()


def test_panel_shows_the_table(bpy_session, compared):
    from rtgi_addon.ui import panels
    from tests.blender.test_ui import drawn_by

    drawn = drawn_by(bpy_session, panels.RTGI_PT_compare)
    assert {"Direct only", "Picture", "rtgi.show_comparison", "rtgi.compare", "keeps_reference"} <= set(drawn)


def test_a_failed_comparison_says_why_in_one_line(bpy_session, empty_scene, tasks):
    with pytest.raises(RuntimeError, match="Compare with Cycles: scene 'Scene' has no camera"):
        bpy_session.ops.rtgi.compare(samples=1)
    assert tasks.running() is None


def test_a_stopped_child_is_gone(tasks, tmp_path):
    from rtgi_addon.ui.child import Child

    child = Child(["warmup"], tmp_path / "log.txt")
    assert child.exit_code() is None
    child.stop()
    assert child.exit_code() not in (None, 0)


def test_one_task_at_a_time(bpy_session, tasks, tmp_path, monkeypatch):
    from rtgi_addon.ui.child import Child

    child = Child(["warmup"], tmp_path / "log.txt")
    monkeypatch.setattr(tasks, "_running", tasks.Task("Warm Up Kernels", child, 10, tasks._WARMED_STEP, tmp_path / "its"))
    assert not bpy_session.ops.rtgi.compare.poll() and not bpy_session.ops.rtgi.warm_up.poll()
    assert bpy_session.ops.rtgi.stop.poll()
    tasks.stop()
    assert child.exit_code() is not None and bpy_session.ops.rtgi.compare.poll()


def test_progress_is_read_from_what_the_child_says(tasks, tmp_path):
    from rtgi_addon.ui.child import Child

    child = Child(["doctor", "--nonsense"], tmp_path / "log.txt")
    limit = time.monotonic() + 120
    while child.exit_code() is None and time.monotonic() < limit:
        time.sleep(0.1)
    assert child.exit_code() == 2                # wrong words
    (tmp_path / "log.txt").write_text("Blender talks\n  1.25 s  loading\n  0.50 s  rsm with method PAPER\n")
    share, words = tasks.Task("Warm Up Kernels", child, 4, tasks._WARMED_STEP, tmp_path).progress()
    assert (share, words) == (0.5, "rsm with method PAPER")
