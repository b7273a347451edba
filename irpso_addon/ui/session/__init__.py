"""The recovery in Blender's window: its job from the scene's settings, its steps, its result, stored recoveries."""
