// Over W×H texels: one iteration of Levenberg–Marquardt, by iteratively reweighted least squares unless the loss is the
// square. Reads the working estimates, u_status, the geometry, the sample stack and what penalty.glsl reads; writes
// o_estimate and o_status.
//
// The first loop over the observations sums JᵀWJ and JᵀWe (linearise.glsl); the second renders the steps of CANDIDATES
// dampings. penalty.glsl adds to the loss: no_penalty.glsl, or that of the prefit or a prior.

#include "refine/linearise.glsl"
#include "refine/status.glsl"
#include "refine/normal_equations.glsl"
#include "fitness/lobes.glsl"
#include "penalty.glsl"

// Ratio of the dampings of one iteration, and their bounds: below 2⁻²⁰ damping is lost in rounding.
#define RATIO 8.0
#define LEAST_DAMPING (1.0 / 1048576.0)
#define MOST_DAMPING 1e6

// The longest step of a searched number, as a fraction of its range. Longer steps end in a corner of the box, where a
// lobe has no strength and so no gradient of its width. Random principled materials in shadow that miss their optimum from
// one start: 1 in 15, without the bound 1 in 10; for two lobes no difference.
#define FARTHEST 0.2

// Adds the model's priors to the normal equations, J per range. The derivative of n log(F + NOISE_FLOOR) + D is that of
// n F + (F + NOISE_FLOOR) D over F + NOISE_FLOOR. JᵀWJ and JᵀWe are half the second and first derivative of the loss
// over loss_scale²; for l1, the whole.
void add_priors(ivec2 texel, inout float c[12], float fitness, inout float a[FREE_COUNT * FREE_COUNT],
                inout float slope[FREE_COUNT])
{
#if PRIORS > 0
    float scale = loss_scale(scale_at(texel));
#if FITNESS == FITNESS_L1
    float unit = 2.0 * (fitness + NOISE_FLOOR) / (scale * scale);
#else
    float unit = (fitness + NOISE_FLOOR) / (scale * scale);
#endif
    float by[12];
    float curvature[12];
    prior_slopes(c, by, curvature);
    for (int u = 0; u < FREE_COUNT; u++) {
        FreeParameter free = free_at(u);
        a[u * FREE_COUNT + u] += unit * free.width * free.width * curvature[free.at];
        slope[u] += unit * free.width * by[free.at];
    }
#endif
}

// The components after a step of all free parameters; the normal stays on its hemisphere.
void stepped(inout float given[12], inout float by[FREE_COUNT], out float c[12])
{
    for (int i = 0; i < 12; i++) {
        c[i] = given[i];
    }
    for (int u = 0; u < FREE_COUNT; u++) {
        FreeParameter free = free_at(u);
        if (is_normal(u)) {
            continue;
        }
        c[free.at] = clamp(c[free.at] + by[u] * free.width, free.low, free.low + free.width);
    }
#if NORMAL_FREE >= 0
    FreeParameter free = free_at(NORMAL_FREE);
    vec3 n = vec3(c[free.at], c[free.at + 1], c[free.at + 2]);
    n = turned_normal(n, free.width * vec2(by[NORMAL_FREE], by[NORMAL_FREE + 1]));
    n = normalize(vec3(n.xy, max(n.z, 0.0)));
    c[free.at] = n.x;
    c[free.at + 1] = n.y;
    c[free.at + 2] = n.z;
#endif
}

void improve(ivec2 texel, inout float c[12], inout vec4 status)
{
    Texel t = observed_texel(texel);
    float a[FREE_COUNT * FREE_COUNT];
    float slope[FREE_COUNT];
    vec2 sums = linearise(t, c, a, slope);
    add_penalty(texel, c, a, slope);
    float fitness = (sums.x + penalty_of(texel, c)) / (3.0 * sums.y);
    float before = with_priors(fitness, sums.y, material_from(c));
    add_priors(texel, c, fitness, a, slope);
    status.w += float(EVALUATIONS);
    // Also ends at NaN: a texel without a fitness cannot improve.
    if (!(sums.y > 0.0 && before < UNFIT)) {
        status.x = UNFIT;
        status.z = CALM;
        return;
    }
    float norm[FREE_COUNT];
    float least[FREE_COUNT];
    float most[FREE_COUNT];
    for (int i = 0; i < FREE_COUNT; i++) {
        norm[i] = sqrt(a[i * FREE_COUNT + i]);
        vec2 room = room_of(c, i);
        least[i] = searched(i) ? max(room.x, -FARTHEST) : room.x;
        most[i] = searched(i) ? min(room.y, FARTHEST) : room.y;
    }
    for (int i = 0; i < FREE_COUNT; i++) {
        slope[i] = norm[i] > 0.0 ? slope[i] / norm[i] : 0.0;
        for (int k = i; k < FREE_COUNT; k++) {
            float both = norm[i] * norm[k];
            a[i * FREE_COUNT + k] = both > 0.0 ? a[i * FREE_COUNT + k] / both : 0.0;
        }
    }
    Material tried[CANDIDATES];
    float lambda[CANDIDATES];
    float size[CANDIDATES];
    float sum[CANDIDATES];
    float damping = status.y / RATIO;
    for (int p = 0; p < CANDIDATES; p++) {
        lambda[p] = clamp(damping, LEAST_DAMPING, MOST_DAMPING);
        damping *= RATIO;
        float by[FREE_COUNT];
        boxed_step(a, slope, norm, lambda[p], least, most, by);
        size[p] = 0.0;
        for (int u = 0; u < FREE_COUNT; u++) {
            size[p] = max(size[p], abs(by[u]));
        }
        float candidate[12];
        stepped(c, by, candidate);
        tried[p] = material_from(candidate);
        sum[p] = penalty_of(texel, candidate);
    }
    float scale = loss_scale(t.scale);
    Observation o;
    EACH_OBSERVATION(t, o) {
        float relative = scale * relative_error(t, o);
        for (int p = 0; p < CANDIDATES; p++) {
            vec3 error = error_of(o, reflectance(tried[p], o.l, o.v));
            sum[p] += o.weight * loss_of(relative * error);
        }
    }
    int chosen = -1;
    float best = before;
    for (int p = 0; p < CANDIDATES; p++) {
        float fitness = with_priors(sum[p] / (3.0 * sums.y), sums.y, tried[p]);
        if (fitness < best) {
            best = fitness;
            chosen = p;
        }
    }
    float gain = (before - best) / before;
    status.x = best;
    if (chosen < 0) {
        // No step was better: the damping jumps past all of them.
        status.y = min(lambda[CANDIDATES - 1] * RATIO * RATIO, MOST_DAMPING);
        status.z += 1.0;
        return;
    }
    for (int p = 0; p < CANDIDATES; p++) {
        if (p == chosen) {
            material_to(tried[p], c);
            order_lobes(c);
            status.y = lambda[p];
            status.z = gain < FTOL || size[p] < XTOL ? status.z + 1.0 : 0.0;
        }
    }
}

bool texel_kernel(ivec2 texel)
{
    float c[12];
    material_to(estimate_at(texel), c);
    vec4 status = texelFetch(u_status, texel, 0);
    if (state_at(texel) == TEXEL_SOLVED && status.z < CALM) {
        improve(texel, c, status);
        // A texel that is done under another δ is not done.
        status.z = u_settles != 0 ? status.z : 0.0;
    }
    write_estimate(c);
    o_status = status;
    return true;
}
