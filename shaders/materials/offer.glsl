// Over W×H texels: tries the materials that the surface shares (shared.glsl), with the texel's own normal or,
// where u_mirror is 1, with the normal that mirrors its brightest sample: if the lobe was missed, so was the normal. Of the
// materials worth refining (offers.glsl) the most probable replaces the texel's; without one the texel is calm.
// Reads the best estimates so far, u_status, u_materials, the geometry, the sample stack and the observation table; writes
// o_estimate and o_status.

#include "fitness/fitness.glsl"
#include "refine/mirror.glsl"
#include "refine/offers.glsl"

bool texel_kernel(ivec2 texel)
{
    Material own = estimate_at(texel);
    vec4 status = write_calm(texel, own);
    if (state_at(texel) != TEXEL_SOLVED) {
        return true;
    }
    float c[12];
    material_to(own, c);
    float own_votes = votes_of_materials(c);
#if NORMAL_FREE >= 0
    if (u_mirror != 0) {
        turn_to_mirror(texel, c);
    }
#endif
    Texel t = observed_texel(texel);
    int count = textureSize(u_materials, 0).x;
    bool found = false;
    float least = 0.0;
    for (int k = 0; k < count; k++) {
        take_material(k, c);
        Material offer = material_from(c);
        float weights;
        float fitness = with_priors(fitness_of(t, offer, weights), weights, offer);
        float freedom = freedom_of(weights);
        // Also skips NaN.
        if (!(fitness < UNFIT)) {
            continue;
        }
        float votes = votes_of_materials(c);
        float deviance = freedom > 0.0 ? deviance_of(freedom, fitness, votes) : fitness;
        if (is_worth_refining(fitness, status.x, votes, own_votes) && (!found || deviance < least)) {
            found = true;
            least = deviance;
            write_material(offer);
        }
    }
    o_status.w += float(count);
    if (found) {
        o_status = fresh_status(o_status.w);
    }
    return true;
}
