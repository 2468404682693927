"""Drives a Blender with its window, from inside: `blender --python tests/real/drive.py -- -o DIR`.

`test_window.py` starts it, presses the keys and takes the pictures that it asks for: a file DIR/N.wish holds a JSON wish and
is gone once it is granted. What was seen goes to DIR/seen.json.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import random
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import bpy

ROOT = Path(__file__).resolve().parent.parent.parent
EXTENSION = "bl_ext.user_default.rtgi"
TICK_S = 0.05
RENDER_LIMIT_S, COMPARE_LIMIT_S = 300.0, 900.0


class Clock:
    """Longest time that the window did not come to its timers, by the name of what went on."""

    def __init__(self) -> None:
        self.name, self.gaps, self._last = "start", {}, time.monotonic()

    def tick(self) -> float:
        now = time.monotonic()
        self.gaps[self.name] = max(self.gaps.get(self.name, 0.0), now - self._last)
        self._last = now
        return TICK_S


def resident_mb() -> float:
    """Memory that this process holds now; 0 where the system does not tell."""
    status = Path("/proc/self/status")
    if not status.is_file():
        return 0.0
    return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmRSS")) / 1024


class Driver:
    """One run; `script` is a generator that yields the seconds to wait before it goes on."""

    def __init__(self, words: argparse.Namespace) -> None:
        self.words, self.clock, self.random = words, Clock(), random.Random(words.seed)
        self.seen: dict = {"blender": bpy.app.version_string, "renders": [], "memory_mb": [], "gaps_s": self.clock.gaps}
        self.ended: list[str] = []
        self._wishes = 0
        bpy.app.handlers.render_complete.append(self._noting("complete"))
        bpy.app.handlers.render_cancel.append(self._noting("cancel"))

    def _noting(self, what: str):
        @bpy.app.handlers.persistent
        def note(*_arguments) -> None:
            self.ended.append(what)
        return note

    def module(self, name: str) -> ModuleType:
        """A module of the add-on, wherever it was installed."""
        return sys.modules[f"{self.words.package}.{name}"]

    # ---- hands ----

    @property
    def window(self) -> bpy.types.Window:
        return bpy.context.window_manager.windows[0]

    def area(self, kind: str) -> bpy.types.Area:
        return next(area for area in self.window.screen.areas if area.type == kind)

    def region(self, kind: str) -> bpy.types.Region:
        return next(region for region in self.area(kind).regions if region.type == "WINDOW")

    def scroll(self, down: bool, pages: int = 1) -> None:
        """Scroll the Properties editor."""
        area, region = self.area("PROPERTIES"), self.region("PROPERTIES")
        with bpy.context.temp_override(window=self.window, area=area, region=region):
            for _ in range(pages):
                (bpy.ops.view2d.scroll_down if down else bpy.ops.view2d.scroll_up)(page=True)

    def wish(self, **what: str) -> Iterator[float]:
        """Ask who waits outside for a key or a picture; Blender's simulated Esc does not reach a render's job."""
        self._wishes += 1
        path = self.words.output / f"{self._wishes}.wish"
        partial = path.with_suffix(".part")
        partial.write_text(json.dumps({"display": os.environ.get("DISPLAY", ""), **what}))
        partial.replace(path)
        yield from self.waiting(lambda: not path.exists(), 30.0, f"the wish {what}")

    def picture(self, name: str) -> Iterator[float]:
        """A picture of the whole window, once it is drawn."""
        for area in self.window.screen.areas:
            area.tag_redraw()
        yield 0.5
        yield from self.wish(picture=name)

    def waiting(self, until, limit_s: float, what: str) -> Iterator[float]:
        """Wait until a condition holds; fails after `limit_s`."""
        start = time.monotonic()
        while not until():
            if time.monotonic() - start > limit_s:
                raise TimeoutError(f"{what} did not end within {limit_s:.0f} s")
            yield TICK_S

    def render(self, name: str, cancel_after_s: float | None = None) -> Iterator[float]:
        """F12, and Esc after a while if asked; notes how it ended, its seconds and the memory after it."""
        before, start = len(self.ended), time.monotonic()
        self.clock.name = name
        yield from self.wish(key="F12")
        if cancel_after_s is not None:
            yield cancel_after_s
            yield from self.wish(key="Escape")
        yield from self.waiting(lambda: len(self.ended) > before and not bpy.app.is_job_running("RENDER"), RENDER_LIMIT_S,
                                name)
        yield 0.2
        self.clock.name = "idle"
        self.seen["renders"].append({"name": name, "end": self.ended[-1], "seconds": round(time.monotonic() - start, 2)})
        self.seen["memory_mb"].append(round(resident_mb(), 1))

    # ---- what is done ----

    def script(self) -> Iterator[float]:
        yield 1.0
        yield from self.open_scene()
        yield from self.look_at_panels("panels_before")
        yield from self.render("first render")
        engine = self.module("engine")
        area, region = self.area("IMAGE_EDITOR"), self.region("IMAGE_EDITOR")
        area.spaces.active.image = bpy.data.images["Render Result"]
        with bpy.context.temp_override(window=self.window, area=area, region=region):
            bpy.ops.image.view_all(fit_view=True)
        self.seen["mean"] = float(engine.last_result().combined[..., :3].mean())
        yield from self.look_at_panels("panels_after")
        yield from self.views_and_undo(engine)
        yield from self.cancelled_render()
        yield from self.compare()
        yield from self.at_random(engine)
        yield from self.look_at_panels("at_the_end")
        yield from self.preferences()

    def open_scene(self) -> Iterator[float]:
        from sample_scenes.build import save_scene

        path = save_scene(self.words.scene, self.words.output)
        bpy.ops.wm.read_homefile(use_factory_startup=True)
        yield 0.5
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
        yield 0.5
        bpy.context.preferences.view.render_display_type = "NONE"
        scene = self.window.scene
        scene.render.engine = "RTGI"
        scene.render.resolution_x, scene.render.resolution_y = self.words.size
        scene.render.resolution_percentage = 100
        self.area("VIEW_3D").type = "IMAGE_EDITOR"
        for kind in ("OUTLINER", "DOPESHEET_EDITOR"):
            with bpy.context.temp_override(window=self.window, area=self.area(kind)):
                bpy.ops.screen.area_close()
            yield 0.2
        if self.words.wide:
            narrow = self.area("PROPERTIES")
            with bpy.context.temp_override(window=self.window, area=self.area("IMAGE_EDITOR")):
                bpy.ops.screen.area_split(direction="VERTICAL", factor=0.88)
            yield 0.2
            editors = [area for area in self.window.screen.areas if area.type == "IMAGE_EDITOR"]
            min(editors, key=lambda area: area.width).type = "PROPERTIES"
            with bpy.context.temp_override(window=self.window, area=narrow):
                bpy.ops.screen.area_close()
            yield 0.2
        self.area("PROPERTIES").spaces.active.context = "RENDER"
        yield 0.5

    def look_at_panels(self, name: str) -> Iterator[float]:
        """Draw all tabs of the Properties editor, those of objects too, and take pictures of RTGI's."""
        space = self.area("PROPERTIES").spaces.active
        layer = self.window.view_layer
        for tab, kind in (("OUTPUT", ""), ("WORLD", ""), ("SCENE", ""), ("MATERIAL", "MESH"), ("OBJECT", "MESH"),
                          ("DATA", "LIGHT"), ("VIEW_LAYER", ""), ("RENDER", "")):
            if kind:
                layer.objects.active = next(item for item in layer.objects if item.type == kind)
                yield 0.2
            space.context = tab
            yield 0.2
            if tab in ("WORLD", "MATERIAL", "DATA", "VIEW_LAYER", "RENDER"):
                yield from self.picture(f"{name}_{tab.lower()}")
        for page in range(1, 4):
            self.scroll(down=True)
            yield from self.picture(f"{name}_render_{page + 1}")
        self.scroll(down=False, pages=4)

    def views_and_undo(self, engine) -> Iterator[float]:
        choice = bpy.context.window_manager.rtgi
        with bpy.context.temp_override(window=self.window):
            bpy.ops.rtgi.show_view()
        yield from self.picture("view_composite")
        for name in list(engine.views()):
            choice.view = name
            yield 0.1
        yield from self.picture("view")
        choice.view = engine.COMPOSITE
        scene = self.window.scene
        before = scene.rtgi.use_rsm
        with bpy.context.temp_override(window=self.window):
            bpy.ops.ed.undo_push(message="before")
            self.window.scene.rtgi.use_rsm = not before
            bpy.ops.ed.undo_push(message="toggle")
            bpy.ops.ed.undo()
        self.seen["undo"] = self.window.scene.rtgi.use_rsm == before
        yield 0.2
        yield from self.render("after undo")

    def cancelled_render(self) -> Iterator[float]:
        render = self.window.scene.render
        size = render.resolution_x, render.resolution_y
        render.resolution_x, render.resolution_y = 1600, 900
        self.window.scene.rtgi.direct.exact_shadows = True
        self.window.scene.rtgi.direct.soft_shadow_rays = 1024
        self.window.scene.rtgi.rsm.rays = 1024
        yield from self.render("cancelled render", 2.0)
        render.resolution_x, render.resolution_y = size
        self.window.scene.rtgi.direct.exact_shadows = False
        with bpy.context.temp_override(window=self.window):
            bpy.ops.rtgi.reset_to_preset()

    def preferences(self) -> Iterator[float]:
        """The add-on's preferences, and a warm-up that is stopped."""
        tasks = self.module("ui.tasks")
        with bpy.context.temp_override(window=self.window):
            bpy.ops.rtgi.warm_up("INVOKE_DEFAULT")
        if self.words.zip:
            area = self.area("IMAGE_EDITOR")
            area.type = "PREFERENCES"
            bpy.context.preferences.active_section = "ADDONS"
            bpy.context.window_manager.addon_search = "RTGI"
            with bpy.context.temp_override(window=self.window, area=area):
                bpy.ops.preferences.addon_expand(module=EXTENSION)
        yield 3.0
        yield from self.picture("warming_up")
        yield from self.wish(key="Escape")
        yield from self.waiting(lambda: tasks.running() is None, 10.0, "the warm-up")

    def compare(self) -> Iterator[float]:
        tasks = self.module("ui.tasks")
        for name, stops in (("stopped comparison", True), ("comparison", False)):
            self.clock.name = name
            with bpy.context.temp_override(window=self.window):
                bpy.ops.rtgi.compare("INVOKE_DEFAULT", samples=self.words.samples)
            task = tasks.running()
            self.scroll(down=True, pages=4)
            yield 2.0
            if stops:
                yield from self.wish(key="Escape")
                yield from self.waiting(lambda: tasks.running() is None, 10.0, name)
                self.seen["stopped"] = task.child.exit_code() is not None and tasks.last_comparison() is None
                continue
            yield from self.picture("comparing")
            yield from self.waiting(lambda: tasks.running() is None, COMPARE_LIMIT_S, name)
            self.seen["compare_exit"], self.seen["compare_log"] = task.child.exit_code(), task.child.lines()[-60:]
            found = tasks.last_comparison()
            yield 0.5
            self.scroll(down=True, pages=4)
            self.seen["comparison"] = [list(row) for row in found.rows] if found else None
            yield from self.picture("compared")
        self.scroll(down=False, pages=4)
        self.clock.name = "idle"

    def at_random(self, engine) -> Iterator[float]:
        """Toggle, choose, undo and render, again and again; some renders are cancelled."""
        techniques = self.module("core.techniques")
        for number in range(self.words.renders):
            scene = self.window.scene
            group, pick = scene.rtgi, self.random
            for _ in range(3):
                name = pick.choice(techniques.optional_techniques())
                setattr(group, f"use_{name}", not getattr(group, f"use_{name}"))
            group.preset = pick.choice(list(techniques.PRESET_PARAMS)[:2])
            group.use_auto = pick.random() < 0.8 or sum(
                getattr(group, f"use_{name}") for name in techniques.optional_techniques()) > 1
            scene.render.film_transparent = pick.random() < 0.2
            tab = pick.choice(("RENDER", "VIEW_LAYER", "OUTPUT", "WORLD"))
            self.area("PROPERTIES").spaces.active.context = tab
            with bpy.context.temp_override(window=self.window):
                bpy.ops.ed.undo_push(message=f"random {number}")
                if pick.random() < 0.2:
                    bpy.ops.ed.undo()
            yield 0.1
            yield from self.render(f"random {number}", pick.random() if pick.random() < 0.15 else None)
            views = list(engine.views())
            bpy.context.window_manager.rtgi.view = pick.choice(views)
        bpy.context.window_manager.rtgi.view = engine.COMPOSITE

    # ---- running ----

    def start(self) -> None:
        steps = self.script()

        def go_on() -> float | None:
            try:
                return next(steps)
            except StopIteration:
                self.finish()
            except Exception:  # noqa: BLE001  the test that waits outside must hear of it
                self.seen["error"] = traceback.format_exc()
                self.finish()
            return None

        bpy.app.timers.register(self.clock.tick, first_interval=TICK_S, persistent=True)
        bpy.app.timers.register(go_on, first_interval=1.0, persistent=True)

    def finish(self) -> None:
        if self.words.zip:
            repos = [repo.module for repo in bpy.context.preferences.extensions.repos]
            bpy.ops.extensions.package_uninstall(repo_index=repos.index("user_default"), pkg_id="rtgi")
            self.seen["left_behind"] = hasattr(bpy.types.Scene, "rtgi")
        (self.words.output / "seen.json").write_text(json.dumps(self.seen, indent=1))
        bpy.ops.wm.quit_blender()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--scene", default="cornell_box")
    parser.add_argument("--size", type=lambda text: tuple(map(int, text.split("x"))), default=(160, 90))
    parser.add_argument("--renders", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--zip", type=Path, help="install this extension, not the checkout, and remove it at the end")
    parser.add_argument("--open-panels", default="last_render,compare", metavar="NAMES", help="of panels closed by default")
    parser.add_argument("--wide", action="store_true", help="a wider Properties editor, for pictures in the docs")
    parser.add_argument("--samples", type=int, default=4, help="of the comparison")
    words = parser.parse_args(sys.argv[sys.argv.index("--") + 1:])
    words.output = words.output.resolve()
    words.output.mkdir(parents=True, exist_ok=True)
    sys.path.insert(0, str(ROOT))
    if words.zip:
        bpy.ops.extensions.package_install_files(repo="user_default", filepath=str(words.zip.resolve()),
                                                 enable_on_install=True)
        words.package = f"{EXTENSION}.rtgi_addon"
    else:
        words.package = "rtgi_addon"
        package = importlib.import_module(words.package)
        panels = importlib.import_module(f"{words.package}.ui.panels")
        for panel in panels.CLASSES:
            if panel.__name__.removeprefix("RTGI_PT_") in words.open_panels.split(","):
                panel.bl_options = set()
        package.register()
    Driver(words).start()


main()
