// Over W×H texels: keeps the material of lower fitness. Reads the best so far (u_estimate, u_status) and the refined
// one (u_work, u_work_status).

#include "common/frame.glsl"
#include "refine/status.glsl"

bool texel_kernel(ivec2 texel)
{
    Status before = status_from(texelFetch(u_status, texel, 0));
    Status after = status_from(texelFetch(u_work_status, texel, 0));
    bool better = state_at(texel) == TEXEL_SOLVED && after.fitness <= before.fitness;
    float c[MAX_COMPONENTS];
    if (better) {
        read_work(texel, c);
    }
    else {
        read_estimate(texel, c);
    }
    write_estimate(c);
    o_status = stored_status(kept_status(before, after, better));
    return true;
}
