"""Image files: headers, EXIF, OpenEXR, raw files; and the way from code values to linear radiance."""
