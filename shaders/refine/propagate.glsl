// Over W×H texels: tries materials of neighbours (proposals), as PatchMatch propagates them (Barnes et al. 2009). The
// four adjacent texels propose their whole material, with the normal rotated into this texel's frame. The four texels
// at distance two propose their searched numbers, to be combined with this texel's normal and linear weights. The most
// probable of the proposals worth refining (proposals.glsl) replaces the texel's material. Without one the texel has
// converged. Reads the best estimates so far, u_status, the geometry with its packing, the sample stack and the
// observation table. Writes o_estimate and o_status.

#include "common/packing.glsl"
#include "fitness/fitness.glsl"
#include "refine/proposals.glsl"

// kind: 0 for the whole material of ``other``, else its searched numbers with the rest of ``own``.
Material proposal_of(ivec2 other, Frame f, int kind, inout float own[MAX_COMPONENTS])
{
    float c[MAX_COMPONENTS];
    float other_c[MAX_COMPONENTS];
    material_to(estimate_at(other), other_c);
    for (int i = 0; i < MAX_COMPONENTS; i++) {
        c[i] = own[i];
    }
    bool whole = kind == 0;
    for (int u = 0; u < FREE_COUNT; u++) {
        if (!is_normal(u) && (whole || searched(u))) {
            int at = free_at(u).at;
            c[at] = other_c[at];
        }
    }
#if NORMAL_FREE >= 0
    if (whole) {
        int at = NORMAL_COMPONENT;
        vec3 n = to_local(f, to_world(frame_at(other), vec3(other_c[at], other_c[at + 1], other_c[at + 2])));
        // 1e-12: the neighbour's normal is the opposite of this frame's normal.
        n.z = max(n.z, 0.0);
        n = dot(n, n) > 1e-12 ? normalize(n) : vec3(0.0, 0.0, 1.0);
        c[at] = n.x;
        c[at + 1] = n.y;
        c[at + 2] = n.z;
    }
#endif
    return material_from(c);
}

bool texel_kernel(ivec2 texel)
{
    Material own = estimate_at(texel);
    Status status = write_converged(texel, own);
    if (state_at(texel) != TEXEL_SOLVED) {
        return true;
    }
    float c[MAX_COMPONENTS];
    material_to(own, c);
    Texel t = observed_texel(texel);
    ivec4 place = surface_place_of(texel);
    Material proposals[PROPOSALS];
    float sum[PROPOSALS];
    bool exists[PROPOSALS];
    for (int p = 0; p < PROPOSALS; p++) {
        int side = p % 4;
        ivec2 offset = side < 2 ? ivec2(2 * side - 1, 0) : ivec2(0, 2 * side - 5);
        ivec2 other = neighbour_at(place, (1 + p / 4) * offset);
        exists[p] = other.x >= 0;
        proposals[p] = own;
        sum[p] = 0.0;
        if (exists[p]) {
            proposals[p] = proposal_of(other, t.frame, p / 4, c);
        }
    }
    float weights = 0.0;
    float inverse_delta = inverse_delta_of(t.radiance_scale);
    Observation o;
    EACH_OBSERVATION(t, o) {
        float scale_over_delta = inverse_delta * error_scale(t, o);
        for (int p = 0; p < PROPOSALS; p++) {
            vec3 error = error_of(o, reflectance(proposals[p], o.l, o.v));
            sum[p] += weighted_loss(o, error, scale_over_delta);
        }
        weights += o.weight;
    }
    status.evaluations += float(PROPOSALS);
    o_status = stored_status(status);
    float freedom = degrees_of_freedom(weights);
    bool support_counts = SEARCHED > 0 && NEIGHBOUR_WEIGHT > 0.0 && freedom > 0.0;
    float own_support = support_counts ? neighbour_support_of(place, c) : 0.0;
    float lowest = 0.0;
    int chosen = -1;
    for (int p = 0; p < PROPOSALS; p++) {
        float fitness = with_priors(sum[p] / (3.0 * weights), weights, proposals[p]);
        // Skips NaN as well.
        if (!(exists[p] && fitness < UNFIT)) {
            continue;
        }
        float proposed[MAX_COMPONENTS];
        material_to(proposals[p], proposed);
        float support = support_counts ? neighbour_support_of(place, proposed) : 0.0;
        float deviance = support_counts ? deviance_of(freedom, fitness, support) : fitness;
        if (is_worth_refining(fitness, status.fitness, support, own_support) && (chosen < 0 || deviance < lowest)) {
            lowest = deviance;
            chosen = p;
        }
    }
    for (int p = 0; p < PROPOSALS; p++) {
        if (p == chosen) {
            write_material(proposals[p]);
            o_status = stored_status(fresh_status(status.evaluations));
        }
    }
    return true;
}
