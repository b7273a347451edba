// Over W×H texels: mean absolute difference between the render of the estimates and the references, independent of the
// fitness. Writes (residual, sum of the weights, largest difference, 0).

#include "common/estimate.glsl"
#include "diagnostics/mean_error.glsl"

bool texel_kernel(ivec2 texel)
{
    o_residual = state_at(texel) == TEXEL_SOLVED ? mean_error(texel, estimate_at(texel)) : vec4(0.0);
    return true;
}
