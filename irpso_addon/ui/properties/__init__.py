"""The user's settings as Blender properties (scene, schedule, preferences), and as plain data."""
