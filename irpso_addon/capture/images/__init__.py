"""Image files: headers, EXIF, colour profiles, OpenEXR, HEIC, raw files; and the way from code values to radiance."""
