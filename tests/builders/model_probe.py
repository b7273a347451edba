"""Evaluates reflectance models on the GPU, with one material, light and view per texel."""

import numpy as np

from irpso_addon.gpu import textures
from irpso_addon.gpu.kernel import Kernel, Output, Packed
from irpso_addon.gpu.passes import Pass
from irpso_addon.reflectance.glsl import material_declaration


def evaluate(root, model, values, light, view, value="reflectance(s, l, v)", entry="fragment"):
    """Return (N, 3): the GLSL expression ``value`` at N materials, incident and view directions."""
    count = len(light)
    components = np.concatenate(
        [np.reshape(values[p.name], (count, p.components)) for p in model.parameters]
        + [np.zeros((count, 12 - model.components))],
        axis=1,
    )
    inputs = {f"u_components_{i}": components[None, :, 4 * i : 4 * i + 4] for i in range(3)}
    inputs |= {"u_light_in": light[None], "u_view_in": view[None]}
    kernel = Kernel(
        str(root / "tests/gpu/kernels/model_probe.glsl"), (Output("o_value"),),
        {"u_components": Packed(3), "u_light_in": "FLOAT_2D", "u_view_in": "FLOAT_2D"}, {},
        {"VALUE": value}, {"material.glsl": material_declaration(model), "model.glsl": model.shader},
    )  # fmt: skip
    one = Pass(kernel, entry)
    target = textures.empty(count, 1, "RGBA32F")
    one.run([target], {n: textures.upload(np.ascontiguousarray(a, np.float32)) for n, a in inputs.items()})
    if entry == "compute":
        copy = Pass(Kernel("common/copy.glsl", (Output("o_copy"),), {"u_source": "FLOAT_2D"}, {}, {}))
        copied = textures.empty(count, 1, "RGBA32F")
        copy.run([copied], {"u_source": target})
        target = copied
    return textures.download(target)[0, :, :3].astype(np.float64)


def single(a):
    """Round to float32; return float64."""
    return np.asarray(a, np.float32).astype(np.float64)
