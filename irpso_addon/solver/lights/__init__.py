"""Light calibration from the images themselves: intensities and small direction errors."""
