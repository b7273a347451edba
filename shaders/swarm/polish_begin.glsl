// Over W×H texels: the estimates with the values of start u_start put in (−1: as they are), to be polished.
// Reads the estimates and u_status. What this tile does not solve stays as it is.

#include "common/frame.glsl"
#include "swarm/polish_state.glsl"
#include "starts.glsl"

bool texel_kernel(ivec2 texel)
{
    float c[12];
    material_to(estimate_at(texel), c);
    if (state_at(texel) == TEXEL_SOLVED) {
        take_start(u_start, c);
    }
    write_estimate(material_from(c));
    o_status = fresh_status(texelFetch(u_status, texel, 0).w);
    return true;
}
