"""The pipeline's progress: one bar for a frame, whatever the techniques report."""

import pytest

from rtgi_addon import pipeline, planner
from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.techniques import LABELS, default_settings
from rtgi_addon.passes.base import Context


def test_techniques_share_what_capture_leaves_of_the_progress():
    said = []
    context = Context(report=lambda text, share: said.append((text, share)))
    frame = make_room_frame(16, 12, world_radiance=0.5)
    settings = default_settings(techniques=[])
    plan = planner.plan_frame(frame, settings, planner.CapturePlan())
    pipeline.run(frame, plan, settings, context)
    assert plan.techniques == ("direct", "world")
    starts = [next(share for text, share in said if text == LABELS[name]) for name in plan.techniques]
    assert starts == pytest.approx([pipeline.CAPTURE_SHARE, (pipeline.CAPTURE_SHARE + 1) / 2])
    assert all(pipeline.CAPTURE_SHARE <= share <= 1 for _, share in said)
    assert context.span == (0.0, 1.0)
