"""Operators that let a second Blender work while the window stays free: Compare with Cycles, Warm Up Kernels.

One task runs at a time. Esc over the window or the panel's button stops it. None of them pushes an undo step or writes to
the user's file: Compare works on a copy in Blender's temporary folder.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ..core.settings import Settings
from ..core.techniques import ALWAYS_ON, LABELS, TECHNIQUE_PARAMS, optional_techniques
from . import pictures, session
from .child import POLL_S, Child

COMPARE_IMAGE = "RTGI Compare"
COMPARE_FOLDER = "rtgi_compare_"
_SAID_STEP = re.compile(r"rtgi: (.+)")
_WARMED_STEP = re.compile(r"\s*\d+\.\d\d s  (.+)")


@dataclass
class Task:
    """What runs now: `steps` is how many lines of progress to expect, `failure` what went wrong at its end."""

    title: str
    child: Child
    steps: int
    pattern: re.Pattern[str]
    folder: Path
    is_stopped: bool = False

    def progress(self) -> tuple[float, str]:
        """(share in [0, 1], the newest step's words)."""
        said = [match[1] for line in self.child.lines() if (match := self.pattern.fullmatch(line))]
        return min(len(said) / max(self.steps, 1), 0.99), said[-1] if said else "starting"

    def tidy_up(self, keeps_results: bool) -> None:
        """Remove the copy of the file, or all that the task wrote; the rest goes when Blender ends."""
        for path in self.folder.glob("*.blend"):
            path.unlink()
        if not keeps_results:
            shutil.rmtree(self.folder, ignore_errors=True)


@dataclass(frozen=True)
class Comparison:
    """Result of the last comparison: (name, seconds, errors of bounce and picture, energy) a row, noise, and the picture."""

    title: str
    rows: tuple[tuple[str, ...], ...]
    picture: str
    reference: str

    @property
    def folders(self) -> set[Path]:
        """Those of our own in Blender's temporary folder that its picture and its reference lie in."""
        holders = {Path(self.picture).parent, Path(self.reference).parent.parent}
        # a reference may be a file of the user's, anywhere
        return {f for f in holders if f.name.startswith(COMPARE_FOLDER) and f.parent == Path(bpy.app.tempdir)}


HEAD = ("", "Time", "Bounce", "Picture", "Energy")
NARROW_COLUMNS = (1, 3)     # what a narrow panel has room for: time and error of the picture
_running: Task | None = None
_comparison: Comparison | None = None


def running() -> Task | None:
    """The task that runs now, or None."""
    return _running


def last_comparison() -> Comparison | None:
    """The newest comparison of this session, or None."""
    return _comparison


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.{1 if value < 0.1 else 0}f} %"


def _row_label(name: str) -> str:
    """A row's name as the panels write it; abbreviations stay, since the column is narrow."""
    return name.upper() if name in LABELS and len(name) <= 4 else LABELS.get(name, name[:1].upper() + name[1:])


def read_comparison(folder: Path) -> Comparison:
    """The table and picture that `rtgi compare -o folder` left."""
    found = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    rows = []
    for name, row in found["rows"].items():
        errors = row["errors"]
        energy = errors["picture"].get("energy")
        rows.append((_row_label(name), f"{row['seconds']:.2f} s" if "seconds" in row else "",
                     _percent(errors.get("bounce", {}).get("block")), _percent(errors["picture"].get("block")),
                     "-" if energy is None else f"{energy:.3f}"))
    noise = found["noise"]
    rows.append(("Cycles' noise", "", _percent(noise.get("bounce")), _percent(noise.get("picture")), ""))
    references = sorted((folder / "references").glob("*.npz"), key=lambda path: path.stat().st_mtime)
    width, height = found["size"]
    return Comparison(f"{found['scene']}, {width}x{height}", tuple(rows), str(folder / "compare.png"),
                      str(references[-1]) if references else "")


def stop() -> None:
    """End what runs, as when the add-on is switched off."""
    global _running
    if _running is not None:
        _running.child.stop()
        _running.tidy_up(keeps_results=False)
        _running = None


class _TaskOperator:
    """Start `_begin`'s task, look at it now and then, and hand its end to `_end`."""

    bl_options = {"REGISTER"}                    # no UNDO: nothing of the file changes

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        if _running is not None:
            cls.poll_message_set(f"{_running.title} is running")
            return False
        return True

    def _begin(self, context: bpy.types.Context) -> Task:
        raise NotImplementedError

    def _end(self, context: bpy.types.Context, task: Task) -> None:
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        global _running
        _running = task = self._begin(context)
        task.child.wait()
        _running = None
        return self._finish(context, task)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        global _running
        if bpy.app.background:
            return self.execute(context)
        _running = self._begin(context)
        self._task = _running
        self._timer = context.window_manager.event_timer_add(POLL_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        self._show(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        global _running
        task = self._task
        if event.type == "ESC" and event.value == "PRESS":
            task.is_stopped = True
        elif event.type != "TIMER":
            return {"PASS_THROUGH"}
        if task.is_stopped or _running is not task:
            self.cancel(context)
            self.report({"INFO"}, f"{task.title}: stopped")
            return {"CANCELLED"}
        if task.child.exit_code() is None:
            self._show(context)
            return {"PASS_THROUGH"}
        self._close(context)
        _running = None
        return self._finish(context, task)

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender calls this when it takes the operator away, as at opening another file."""
        global _running
        self._close(context)
        self._task.child.stop()
        self._task.tidy_up(keeps_results=False)
        if _running is self._task:
            _running = None
        session.redraw()

    def _close(self, context: bpy.types.Context) -> None:
        context.window_manager.event_timer_remove(self._timer)
        if context.workspace is not None:
            context.workspace.status_text_set(None)

    def _show(self, context: bpy.types.Context) -> None:
        _, words = self._task.progress()
        if context.workspace is not None:
            context.workspace.status_text_set(f"RTGI: {self._task.title}: {words} (Esc stops)")
        session.redraw()

    def _finish(self, context: bpy.types.Context, task: Task) -> set[str]:
        session.redraw()
        task.tidy_up(keeps_results=True)
        if task.child.exit_code() != 0:
            said = [line for line in task.child.lines() if line.startswith("rtgi: ")]
            why = said[-1].removeprefix("rtgi: ") if said else f"exit code {task.child.exit_code()}"
            self.report({"ERROR"}, f"{task.title}: {why}")
            return {"CANCELLED"}
        self._end(context, task)
        return {"FINISHED"}


class RTGI_OT_stop(bpy.types.Operator):
    """Stop what RTGI does in the background"""

    bl_idname = "rtgi.stop"
    bl_label = "Stop"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return _running is not None

    def execute(self, _context: bpy.types.Context) -> set[str]:
        _running.is_stopped = True
        return {"FINISHED"}


def _expected_steps(settings: Settings) -> int:
    """Lines of progress of a comparison: the reference, RTGI, direct light, each technique, four peers."""
    return 7 + len([name for name in optional_techniques() if settings.enabled.get(name, name in ALWAYS_ON)])


class RTGI_OT_compare(_TaskOperator, bpy.types.Operator):
    """Render a copy of this file with RTGI, each technique alone, and Cycles with one bounce, in the background: times and errors, and both pictures beside the error map"""  # noqa: E501  Blender shows it as one tooltip

    bl_idname = "rtgi.compare"
    bl_label = "Compare with Cycles"

    samples: bpy.props.IntProperty(
        name="Samples", default=64, min=1, max=65536, soft_max=1024,
        description="Samples a pixel of each of the two halves of Cycles' picture")
    reference: bpy.props.StringProperty(
        name="Reference", default="", subtype="FILE_PATH", options={"SKIP_SAVE"},
        description="Picture of Cycles from an earlier comparison; left empty, it is rendered")

    def _begin(self, context: bpy.types.Context) -> Task:
        from .props import settings_from_scene

        folder = Path(tempfile.mkdtemp(prefix=COMPARE_FOLDER, dir=bpy.app.tempdir))
        name = Path(bpy.data.filepath).stem or context.scene.name
        copy = folder / f"{bpy.path.clean_name(name)}.blend"
        bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True, check_existing=False)
        words = ["compare", str(copy), "-o", str(folder), "--samples", str(self.samples), "--peers", "1,4",
                 "--cache", str(folder / "references")]
        if self.reference:
            words += ["--reference", self.reference]
        return Task(self.bl_label, Child(words, folder / "log.txt"), _expected_steps(settings_from_scene(context.scene)),
                    _SAID_STEP, folder)

    def _end(self, _context: bpy.types.Context, task: Task) -> None:
        global _comparison
        before, found = _comparison, read_comparison(task.folder)
        _comparison = Comparison(found.title, found.rows, found.picture, found.reference or self.reference)
        if before is not None:
            for folder in before.folders - _comparison.folders:
                shutil.rmtree(folder, ignore_errors=True)
        pictures.show(pictures.from_file(COMPARE_IMAGE, Path(found.picture)))
        self.report({"INFO"}, f"RTGI: compared in {task.child.seconds:.0f} s")


class RTGI_OT_show_comparison(bpy.types.Operator):
    """Show RTGI, Cycles and the error map of the last comparison in an Image Editor"""

    bl_idname = "rtgi.show_comparison"
    bl_label = "Show Pictures"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return _comparison is not None and Path(_comparison.picture).is_file()

    def execute(self, _context: bpy.types.Context) -> set[str]:
        pictures.show(pictures.from_file(COMPARE_IMAGE, Path(_comparison.picture)))
        return {"FINISHED"}


class RTGI_OT_warm_up(_TaskOperator, bpy.types.Operator):
    """Compile every kernel now, in the background, so that no render has to wait for it"""

    bl_idname = "rtgi.warm_up"
    bl_label = "Warm Up Kernels"

    def _begin(self, _context: bpy.types.Context) -> Task:
        from ..warmup import variants
        from .preferences import preferred_threads

        threads = preferred_threads()
        words = ["warmup", *(["--threads", str(threads)] if threads else [])]
        folder = Path(tempfile.mkdtemp(prefix="rtgi_warmup_", dir=bpy.app.tempdir))
        steps = 3 + sum(len(list(variants(kind()))) for kind in TECHNIQUE_PARAMS.values())
        return Task(self.bl_label, Child(words, folder / "log.txt"), steps, _WARMED_STEP, folder)

    def _end(self, _context: bpy.types.Context, task: Task) -> None:
        self.report({"INFO"}, f"RTGI: kernels are ready after {task.child.seconds:.0f} s")


def draw_running(layout: Any, title: str) -> bool:
    """Progress and the stop button of the running task, if it is the one called `title`; whether it was drawn."""
    if _running is None or _running.title != title:
        return False
    share, words = _running.progress()
    row = layout.row(align=True)
    row.progress(factor=share, text=words)
    row.operator("rtgi.stop", text="", icon="CANCEL")
    return True


CLASSES = (RTGI_OT_stop, RTGI_OT_compare, RTGI_OT_show_comparison, RTGI_OT_warm_up)
