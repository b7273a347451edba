"""Image files: headers, EXIF, colour profiles, OpenEXR, HEIC, raw files; and conversion of code values to radiance."""
