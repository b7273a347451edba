// Over W×H texels: starts a refinement from the estimates with the values of start u_start (−1: none). A start may turn
// the normal (mirror.glsl). Texels of other tiles stay as they are. Reads the estimates, u_status and the samples.

#include "refine/mirror.glsl"
#include "refine/status.glsl"
#include "starts.glsl"

bool texel_kernel(ivec2 texel)
{
    float c[MAX_COMPONENTS];
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
    o_status = stored_status(fresh_status(status_from(texelFetch(u_status, texel, 0)).evaluations));
    return true;
}
