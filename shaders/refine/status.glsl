// State of a texel's refinement: its material, packed like the estimates, and o_status: (fitness, damping λ,
// consecutive iterations without a change, evaluations so far).

#include "common/estimate.glsl"
#include "fitness/unfit.glsl"

// A texel has converged after this many iterations without a change.
#define CONVERGED_AFTER 2.0

vec4 fresh_status(float evaluations)
{
    return vec4(UNFIT, DAMPING, 0.0, evaluations);
}

void write_material(Material s)
{
    float c[12];
    material_to(s, c);
    write_estimate(c);
}
