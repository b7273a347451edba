"""What the user sets: scene settings, schedule, preferences; and the same as plain data."""
