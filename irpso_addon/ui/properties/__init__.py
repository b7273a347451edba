"""The user's settings: scene, schedule, preferences; and the same as plain data."""
