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

void write_material(Material s)
{
    float c[12];
    material_to(s, c);
    write_estimate(c);
}
