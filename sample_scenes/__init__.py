"""Ten scenes, built by scripts, in which one bounce of light matters. `python -m sample_scenes.build --list` names them."""

SCENES = (
    "cornell_box",
    "coloured_corner",
    "flashlight",
    "glossy_hall",
    "thin_wall_maze",
    "sunlit_colonnade",
    "animated_door",
    "courtyard",
    "many_lights",
    "caustics",
)
