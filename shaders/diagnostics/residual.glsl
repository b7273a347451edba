// Over W×H texels: mean absolute error between the renders of the estimates and the samples, by their weights in the
// fitness. Writes o_residual: (mean error, sum of weights, largest error, 0).

#include "common/estimate.glsl"
#include "diagnostics/mean_error.glsl"

bool texel_kernel(ivec2 texel)
{
    o_residual = state_at(texel) == TEXEL_SOLVED ? mean_error(texel, estimate_at(texel)) : vec4(0.0);
    return true;
}
