// Over W×H texels: tries the materials that the surface shares (shared.glsl), with the texel's own normal or,
// where u_mirror is 1, with that which mirrors its brightest sample: where the lobe was missed, so was the normal. One is
// taken, to be refined, where its fitness is under CANDIDATE_RATIO times this texel's own, or where it has more votes by the
// factor CROWD; of several the most probable. Where there is none, nothing is left to be done.
// Reads the best estimates so far, u_status, the materials and the samples.

#include "fitness/fitness.glsl"
#include "refine/mirror.glsl"
#include "refine/status.glsl"
#include "refine/votes.glsl"

bool texel_kernel(ivec2 texel)
{
    Material own = estimate_at(texel);
    vec4 status = texelFetch(u_status, texel, 0);
    o_status = vec4(status.xy, CALM, status.w);
    write_material(own);
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
        // Written so that NaN is no offer.
        if (!(fitness < UNFIT)) {
            continue;
        }
        float votes = votes_of_materials(c);
        float deviance = freedom > 0.0 ? deviance_of(freedom, fitness, votes) : fitness;
        bool wanted = fitness < CANDIDATE_RATIO * status.x || votes > CROWD * (1.0 + own_votes);
        if (wanted && (!found || deviance < least)) {
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
