// The same as diagnostics/residual.glsl, for the texels that u_sampled lists (−1: none).

#include "common/estimate.glsl"
#include "diagnostics/mean_error.glsl"

bool texel_kernel(ivec2 place)
{
    ivec2 texel = ivec2(texelFetch(u_sampled, place, 0).xy);
    o_residual = vec4(0.0);
    if (texel.x >= 0 && state_at(texel) == TEXEL_SOLVED) {
        o_residual = mean_error(texel, estimate_at(texel));
    }
    return true;
}
