"""The 24-patch colour chart found in photographs, in any turn and in perspective. OpenCV finds outlines."""
