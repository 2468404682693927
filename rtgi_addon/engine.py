"""The render engine RTGI: captures a frame through Cycles, runs the pipeline and hands the picture to Blender."""

from __future__ import annotations

import contextlib
import traceback

import bpy
import numpy as np

from .capture import geometry as capture_geometry
from .capture import materials as capture_materials
from .capture import world as capture_world
from .capture.kept_views import KeptViews
from .capture.lights import lights_out, read_lights
from .capture.needs import read_needs
from .capture.unsupported import unsupported_warnings
from .capture.versions import pass_name
from .capture.views import ViewCapture, full_sphere, main_camera, read_window, world_axes
from .core import suns
from .core.frame import Frame, World
from .core.transforms import ViewFormat
from .errors import Cancelled, InputError, RtgiError

FAR_FROM_ORIGIN_M = 1000.0  # a camera farther out than this becomes the frame's own origin, to keep float32 digits
IMAGE_NAME = "RTGI"
OUTPUT_PASSES = (("RTGI Direct", "RGB"), ("RTGI World", "RGB"), ("RTGI Diffuse Bounce", "RGB"),
                 ("RTGI Glossy Bounce", "RGB"), ("RTGI Visibility", "X"))

COMPOSITE, VISIBILITY = "composite", "visibility"

_last_result = None
_shown_view = COMPOSITE
_persistent_data: dict[str, bool] = {}
_geometry_cache = capture_geometry.GeometryCache()
_keeps_views = True
_context = None


def last_result():
    """`pipeline.Result` of the newest finished render, or None."""
    return _last_result


def views():
    """{name: what it is} of the pictures that the image "RTGI" can show of the last render."""
    found = {COMPOSITE: "The picture"}
    if _last_result is not None:
        for transport in _last_result.transports:
            found[transport.value] = ("Irradiance, W/m2; colours of surfaces are not in it" if transport.is_diffuse else
                                      "Radiance, W/(m2 sr)")
        found[VISIBILITY] = "Share of the surroundings that techniques of ambient visibility left open; 1 where none ran"
        found.update(dict.fromkeys(_last_result.pictures, "Drawn by a technique of itself"))
    return found


def shown_view():
    """Name of the view that the image "RTGI" shows."""
    return _shown_view


def show_view(name):
    """Let the image "RTGI" show the view `name` of the last and of further renders."""
    global _shown_view
    _shown_view = name
    _write_image()


@contextlib.contextmanager
def every_view_anew():
    """For the time of the block lamps' views are rendered in every frame, as in a single one, also where nothing moved."""
    global _keeps_views
    before, _keeps_views = _keeps_views, False
    try:
        yield
    finally:
        _keeps_views = before


def _shared_context():
    """One pass context for all renders, so that the BVH of an unchanged scene is kept between frames."""
    global _context
    if _context is None:
        from .passes.base import Context

        _context = Context()
    return _context


class RTGIEngine(bpy.types.RenderEngine):
    """Delegates to Cycles for G-buffers and adds light with RTGI's passes."""

    bl_idname = "RTGI"
    bl_label = "RTGI"
    bl_use_eevee_viewport = True
    bl_use_postprocess = True
    bl_use_exclude_layers = True
    bl_use_spherical_stereo = False

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.session = None
        self._kept = KeptViews()
        self._open = contextlib.ExitStack()      # what is put on the evaluated copies between update and the end of render

    def __del__(self):
        # Blender may have freed the struct, or never have run __init__
        with contextlib.suppress(ReferenceError, AttributeError, ImportError):    # the last: Python is shutting down
            from cycles import engine as cycles_engine

            cycles_engine.free(self)

    def update_render_passes(self, scene, view_layer):
        """Register the passes that the compositor and multilayer files see, and those that capture reads."""
        from cycles import engine as cycles_engine

        cycles_engine.register_passes(self, scene, view_layer)
        taken = {name for name, *_ in cycles_engine.list_render_passes(scene, view_layer)}
        for name, channels, kind in read_needs(scene).passes():
            if name not in taken:
                self.register_pass(scene, view_layer, name, len(channels), channels, kind)
        for name, channels in OUTPUT_PASSES:
            self.register_pass(scene, view_layer, name, len(channels), channels, "COLOR" if len(channels) == 3 else "VALUE")

    def update(self, data, depsgraph):
        """Prepare the evaluated copies and hand the scene to Cycles."""
        from cycles import engine as cycles_engine

        self._open.close()
        self._failure = None
        try:
            self._prepare(data, depsgraph)
            if not self.session:
                cycles_engine.create(self, data)
            cycles_engine.reset(self, data, depsgraph)
        except RtgiError as error:
            self._failure = str(error)
            self._open.close()

    def _prepare(self, data, depsgraph):
        scene = depsgraph.scene_eval
        cycles = scene.cycles
        self._kept.note_updates(depsgraph)
        cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = 1, False, False
        cycles.seed, cycles.use_animated_seed = 0, False             # a view of the same is the same in every frame
        cycles.max_bounces, cycles.use_light_tree, cycles.use_guiding = 0, False, False
        # no bounce still follows a path to its next surface and shades that, unless ambient occlusion is to stand in for it
        cycles.use_fast_gi, cycles.fast_gi_method, cycles.ao_bounces_render = True, "REPLACE", 1
        cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 0.01    # a box is always a pixel wide
        depsgraph.view_layer_eval.cycles.denoising_pass_follow_reflections = False
        camera = self.camera_override
        if camera is None:
            raise InputError("the scene has no camera; add one or choose one in Scene Properties")
        self._window = read_window(depsgraph.scene.render)
        self._warnings = ()
        place = np.array(camera.matrix_world, np.float64)[:3, 3]
        self._origin_ws = place if np.linalg.norm(place) > FAR_FROM_ORIGIN_M else np.zeros(3)
        size = (1, 1)                            # the true size is known with the first render result
        main_camera(camera, self._window, size, self._origin_ws)     # refuses a panorama before Cycles starts
        self._lights = read_lights(depsgraph, self._origin_ws)
        self._materials = capture_materials.read_materials(depsgraph, _geometry_cache.materials)
        self._world = capture_world.read_world_constant(depsgraph)
        self._warnings = unsupported_warnings(depsgraph, self._materials) + self._world.warnings
        if camera.data.dof.use_dof:
            camera.data.dof.use_dof = False      # the evaluated copy: a lens would smear positions over pixels
            self._open.callback(setattr, camera.data.dof, "use_dof", True)
        if scene.render.use_motion_blur:
            scene.render.use_motion_blur = False
        if read_needs(depsgraph.scene).material_index:
            capture_materials.number_materials(depsgraph, self._materials)
        self._data = data
        self._open.enter_context(lights_out(depsgraph))

    def render(self, depsgraph):
        """Blender's entry: one view layer of one frame. Errors become one line for the user."""
        try:
            if self._failure:
                raise InputError(self._failure)
            self._render(depsgraph)
        except Cancelled:
            self.update_stats("", "RTGI: cancelled")
        except RtgiError as error:
            self._fail(str(error))
        except ImportError as error:
            self._fail(f"{error.name or 'a library'} does not load ({error}); install the zip that is made for this system, "
                       "it brings numba along, or install numba into Blender's Python")
        except Exception as error:  # noqa: BLE001  an error must not pass as a finished black frame
            traceback.print_exc()
            self._fail(f"RTGI failed: {type(error).__name__}: {error}; the console has the details")
        finally:
            self._open.close()

    def _fail(self, text):
        # either alone is lost: the report reaches scripts, the error reaches the window
        self.report({"ERROR"}, text)
        self.error_set(text)

    def _render(self, depsgraph):
        context = _shared_context()
        with context.listening(self.test_break, self._report):
            self._render_with(context, depsgraph)

    def _render_with(self, context, depsgraph):
        global _last_result
        from . import budget, pipeline, planner
        from .kernels.jit import kernel_session

        scene = depsgraph.scene
        settings, stages = _settings_of(scene), pipeline.Stages()
        settings.validate()
        frame, capture_plan = self._capture(depsgraph, settings, context, stages)
        plan = planner.plan_frame(frame, settings, capture_plan)
        has_target = bool(settings.target_time_s or settings.target_error)
        speed = budget.speed_of(settings.threads) if has_target else 1.0
        choice = budget.within_budget(plan, settings, stages.total_ms, speed)
        result = pipeline.run(frame, choice.plan, choice.settings, context, stages, scene.render.film_transparent)
        context.checkpoint("Write result", 1.0)
        with stages("write"), kernel_session(settings.threads):
            if scene.cycles.film_exposure != 1:
                result.combined[..., :3] *= scene.cycles.film_exposure
            self._write(depsgraph, frame, result)
            _last_result = result
            _publish_image()
        result.report["stages"], result.report["total_ms"] = stages.to_json(), round(stages.total_ms, 2)
        budget.learn(choice, result.report["stages"], settings.threads)
        result.report["versions"]["blender"] = bpy.app.version_string
        for line in frame.warnings:
            self.report({"INFO"}, line)

    def _report(self, text, share):
        self.update_stats("", f"RTGI: {text}")
        self.update_progress(min(max(share, 0.0), 1.0))

    def _capture(self, depsgraph, settings, context, stages):
        """Frame of this view layer: triangles, the camera's view, each light's view, the world."""
        from . import emitter_lamps, light_views, planner
        from .kernels.jit import kernel_session
        from .passes.surroundings import surroundings_of

        context.checkpoint("Read triangles", 0.0)
        with stages("triangles"):
            geometry = capture_geometry.read_geometry(depsgraph, self._materials, self._origin_ws, _geometry_cache)
            if _keeps_views:
                self._kept.settle(geometry, _geometry_cache.ranges, self._origin_ws, self._materials.evaluated)
            else:
                self._kept = KeptViews()
        views = ViewCapture(self, self._data, depsgraph, self._origin_ws, self._materials)
        context.checkpoint("Camera view", 0.05)
        with stages("camera view"):
            self._raw = views.passes()
            height, width = self._raw["Depth"].shape[:2]
            camera = main_camera(self.camera_override, self._window, (width, height), self._origin_ws)
            with kernel_session(settings.threads):
                gbuffer = views.to_gbuffer(self._raw, camera)
        context.checkpoint()
        with stages("world"):
            world, suns_of_world = self._capture_world(views, width, height)
            lights = self._lights + suns_of_world
        materials = self._materials.materials
        with stages("bvh"), kernel_session(settings.threads):
            bvh = context.bvh(geometry)
            if settings.params["emission"].as_lamps:
                geometry, shining = emitter_lamps.part_emitters(geometry, materials, bvh)
                lights += shining
        frame = Frame(camera, gbuffer, lights, (), geometry, materials, world, self._origin_ws, self._warnings)
        low, high = geometry.bounds_ws
        facts = planner.SceneFacts(lights, self._world.kind, self._materials.has_glossy, self._materials.has_emission,
                                   _geometry_cache.has_shadowless)
        plan = planner.plan_capture(facts, settings, (low + high) / 2, float(np.linalg.norm(high - low)) / 2)
        captured = []
        around = surroundings_of(frame, geometry) if plan.cast_views else None
        for number, i in enumerate((*plan.cycles_views, *plan.cast_views)):
            light = lights[i]
            context.checkpoint(f"View of {light.name}", 0.1 + 0.3 * number / len(lights))
            cast = i in plan.cast_views
            texels = min(plan.view_texels, planner.CAST_VIEW_TEXELS) if cast else plan.view_texels
            form = ViewFormat(texels) if cast else views.format_of_views(texels)
            with stages("fit light views"), kernel_session(settings.threads):
                light_camera = light_views.camera_of(light, frame, bvh, form)
            if light_camera is None:
                continue
            with stages("light views"):
                near_m, far_m = light_views.clip_range_m(light, light_camera, frame)
                seen = self._kept.find(light, light_camera, near_m)
                if seen is None and cast:
                    with kernel_session(settings.threads):
                        seen = light_views.cast_view(light, light_camera, frame, bvh, around)
                elif seen is None:
                    with views.looking_through(light_camera, near_m, far_m):
                        passes = views.passes(light_camera)
                    with kernel_session(settings.threads):
                        seen = views.to_gbuffer(passes, light_camera)
                if _keeps_views:
                    self._kept.put(light, light_camera, near_m, seen)
                captured.append(light_views.view_of(i, light, light_camera, seen))
        return Frame(camera, gbuffer, lights, tuple(captured), geometry, materials, world, self._origin_ws,
                     self._warnings), plan

    def _capture_world(self, views, width, height):
        """(the world without its suns, these as lamps)."""
        if self._world.kind == "constant":
            return World(np.asarray(self._world.radiance, np.float32).reshape(1, 1, 3)), ()
        if self._world.kind == "black":
            return World(), ()
        world = views.depsgraph.scene_eval.world
        radiance = views.environment(full_sphere(*views.format_of_views(width * height).panorama_px, world_axes()))
        radiance, found = suns.part_suns(radiance, views.environment, views.format_of_views(suns.CLOSE_PX**2),
                                         f"sun of {world.name_full}", capture_world.sky_suns(world))
        return World(radiance), found

    def _write(self, depsgraph, frame, result):
        """Combined, our passes and every pass that the user asked for into the render result."""
        from .output import Output

        height, width = frame.gbuffer.shape
        raw, index = dict(self._raw), pass_name("Material Index")
        if index in raw and read_needs(depsgraph.scene).material_index:
            numbers = self._materials.pass_index
            raw[index] = numbers[np.clip(raw[index].astype(np.int32), 0, len(numbers) - 1)]
        output = Output(frame, result, raw)
        target = self.begin_result(0, 0, width, height, layer=depsgraph.view_layer.name)
        for render_pass in target.layers[0].passes:
            flat = output.flat(render_pass.name)
            if flat is not None:
                render_pass.rect.foreach_set(flat)
        self.end_result(target)

    def render_frame_finish(self):
        from cycles import engine as cycles_engine

        cycles_engine.render_frame_finish(self)


def _view_pixels(result):
    """(H, W, 4) float32 of the view that is chosen, of the composite where this render has no such view."""
    pictures = {transport.value: light for transport, light in result.transports.items()}
    pictures |= {VISIBILITY: np.repeat(result.visibility[..., None], 3, -1), **result.pictures}
    if _shown_view not in pictures:
        return result.combined
    return np.dstack([pictures[_shown_view], np.ones(result.visibility.shape, np.float32)])


def _publish_image():
    """Write the image datablock: now, or as soon as the window is idle, which may be drawing it at this moment."""
    if bpy.app.background:
        _write_image()
    elif not bpy.app.timers.is_registered(_write_image):
        bpy.app.timers.register(_write_image, first_interval=0.0)


def _write_image():
    """The chosen view of the last render as the float image datablock "RTGI", in place where it exists."""
    if _last_result is None:
        return
    pixels = _view_pixels(_last_result)
    height, width = pixels.shape[:2]
    image = bpy.data.images.get(IMAGE_NAME)
    if image is not None and (tuple(image.size) != (width, height) or not image.is_float or image.source != "GENERATED"):
        if image.source == "GENERATED" and image.is_float:
            image.scale(width, height)
        else:
            return                               # a file of the user's own under that name: leave it alone
    if image is None:
        image = bpy.data.images.new(IMAGE_NAME, width, height, alpha=True, float_buffer=True)
    image.pixels.foreach_set(np.ascontiguousarray(pixels[::-1], np.float32).ravel())
    image.update()


def _settings_of(scene):
    from .ui.props import settings_from_scene

    return settings_from_scene(scene)


def _keep_depsgraph(scene, *_):
    """Cycles frees the depsgraph after the first view unless data is persistent; the user's value comes back after."""
    if scene.render.engine == RTGIEngine.bl_idname and scene.name not in _persistent_data:
        _persistent_data[scene.name] = scene.render.use_persistent_data
        scene.render.use_persistent_data = True


def _restore_persistent_data(scene, *_):
    if scene.name in _persistent_data:
        scene.render.use_persistent_data = _persistent_data.pop(scene.name)


_HANDLERS = (("render_init", _keep_depsgraph), ("render_complete", _restore_persistent_data),
             ("render_cancel", _restore_persistent_data))


def register():
    """Register the engine class and the handlers around a render."""
    bpy.utils.register_class(RTGIEngine)
    for name, function in _HANDLERS:
        getattr(bpy.app.handlers, name).append(bpy.app.handlers.persistent(function))


def unregister():
    """Undo `register`."""
    global _last_result, _context
    for name, function in _HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if function in handlers:
            handlers.remove(function)
    if bpy.app.timers.is_registered(_write_image):
        bpy.app.timers.unregister(_write_image)
    bpy.utils.unregister_class(RTGIEngine)
    _last_result = _context = None
