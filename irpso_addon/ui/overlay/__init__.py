"""The overlay of a recovery in the viewport and the Image editor."""
