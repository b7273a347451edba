// Over W×H texels: initialises the working estimates of a refinement with the values of start u_start (−1: none). A
// start may turn the normal (mirror.glsl). Texels that this tile does not solve keep their estimates.
// Reads the estimates, u_status and the samples. Writes o_estimate and o_status.

#include "refine/mirror.glsl"
#include "refine/status.glsl"
#include "starts.glsl"

bool texel_kernel(ivec2 texel)
{
    float c[12];
    material_to(estimate_at(texel), c);
    if (state_at(texel) == TEXEL_SOLVED) {
        take_start(u_start, c);
#ifdef NORMAL_COMPONENT
        if (mirrors(u_start)) {
            turn_to_mirror(texel, c);
        }
#endif
    }
    write_estimate(c);
    o_status = fresh_status(texelFetch(u_status, texel, 0).w);
    return true;
}
