"""Blender to Frame: with engine, ui and the command line the only code that imports bpy."""
