// Over W×H texels: the better of two materials. Reads the best so far (u_estimate_…, u_status) and what has been worked
// on (u_work_…, u_work_status).

#include "common/frame.glsl"
#include "refine/status.glsl"

bool texel_kernel(ivec2 texel)
{
    vec4 before = texelFetch(u_status, texel, 0);
    vec4 after = texelFetch(u_work_status, texel, 0);
    bool better = state_at(texel) == TEXEL_SOLVED && after.x <= before.x;
    o_estimate_0 = better ? texelFetch(u_work_0, texel, 0) : texelFetch(u_estimate_0, texel, 0);
#if ESTIMATES > 1
    o_estimate_1 = better ? texelFetch(u_work_1, texel, 0) : texelFetch(u_estimate_1, texel, 0);
#endif
#if ESTIMATES > 2
    o_estimate_2 = better ? texelFetch(u_work_2, texel, 0) : texelFetch(u_estimate_2, texel, 0);
#endif
    o_status = better ? after : before;
    o_status.w = max(before.w, after.w);
    return true;
}
