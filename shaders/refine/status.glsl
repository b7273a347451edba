// What the refinement remembers of a texel: its material, packed as the estimates are, and o_status: (fitness, damping λ,
// iterations in a row that changed nothing, evaluations so far).

#include "common/estimate.glsl"
#include "fitness/unfit.glsl"

// A texel is done once so many iterations have changed nothing.
#define CALM 2.0

vec4 fresh_status(float evaluations)
{
    return vec4(UNFIT, DAMPING, 0.0, evaluations);
}

void write_estimate(Material s)
{
    float c[12];
    material_to(s, c);
    o_estimate_0 = vec4(c[0], c[1], c[2], c[3]);
#if ESTIMATES > 1
    o_estimate_1 = vec4(c[4], c[5], c[6], c[7]);
#endif
#if ESTIMATES > 2
    o_estimate_2 = vec4(c[8], c[9], c[10], c[11]);
#endif
}
