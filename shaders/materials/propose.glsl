// Over W×H texels: tries the materials that the surface shares (shared.glsl), with the texel's own normal or, if
// u_mirror is 1, with the normal that mirrors its brightest sample: a fit that missed the lobe also missed the normal.
// The most probable material worth refining (proposals.glsl) replaces the texel's. Without one the texel has converged.
// Reads the best estimates so far, u_status, u_materials, the geometry, the sample stack and the observation table;
// writes o_estimate and o_status.

#include "fitness/fitness.glsl"
#include "refine/mirror.glsl"
#include "refine/proposals.glsl"

bool texel_kernel(ivec2 texel)
{
    Material own_material = estimate_at(texel);
    Status status = write_converged(texel, own_material);
    if (state_at(texel) != TEXEL_SOLVED) {
        return true;
    }
    float c[MAX_COMPONENTS];
    material_to(own_material, c);
    float own_support = material_support_of(c);
#if NORMAL_FREE >= 0
    if (u_mirror != 0) {
        turn_to_mirror(texel, c);
    }
#endif
    Texel t = observed_texel(texel);
    int count = textureSize(u_materials, 0).x;
    bool found = false;
    float lowest = 0.0;
    for (int k = 0; k < count; k++) {
        take_material(k, c);
        Material proposal = material_from(c);
        float weights;
        float fitness = with_priors(fitness_of(t, proposal, weights), weights, proposal);
        float freedom = degrees_of_freedom(weights);
        // Skips NaN as well.
        if (!(fitness < UNFIT)) {
            continue;
        }
        float support = material_support_of(c);
        float deviance = freedom > 0.0 ? deviance_of(freedom, fitness, support) : fitness;
        if (is_worth_refining(fitness, status.fitness, support, own_support) && (!found || deviance < lowest)) {
            found = true;
            lowest = deviance;
            write_material(proposal);
        }
    }
    status.evaluations += float(count);
    if (found) {
        status = fresh_status(status.evaluations);
    }
    o_status = stored_status(status);
    return true;
}
