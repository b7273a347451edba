"""Linear images from camera files: response curves, brackets, dark frames, flat fields, white balance."""
