"""Search for the 24-patch colour chart and the grey card in photographs, in any orientation; needs OpenCV."""
