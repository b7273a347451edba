"""Oracle of depth and normals: Cycles' render passes of the open scene."""

import bpy
import numpy as np
import OpenEXR


def rendered_passes(path, pixels):
    """Render pixels × pixels with one sample at each pixel's centre; return channel name → (H, W), row 0 at the bottom.

    Depth and normal are among the passes.
    """
    settings, cycles = bpy.context.scene.render, bpy.context.scene.cycles
    settings.engine, settings.filepath = "CYCLES", str(path)
    settings.resolution_x = settings.resolution_y = pixels
    if hasattr(settings.image_settings, "media_type"):
        settings.image_settings.media_type = "MULTI_LAYER_IMAGE"
    settings.image_settings.file_format, settings.image_settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    cycles.samples, cycles.pixel_filter_type, cycles.filter_width = 1, "BOX", 0.01
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    layer = bpy.context.view_layer
    layer.use_pass_normal = layer.use_pass_z = True
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels[::-1] for part in file.parts for name, channel in part.channels.items()}


def normals_of(channels):
    """Return (H, W, 3) float64: the normal pass."""
    return np.stack([channels[f"ViewLayer.Normal.{axis}"] for axis in "XYZ"], axis=-1).astype(np.float64)
