// Over W×H texels: one iteration of Levenberg–Marquardt, by iteratively reweighted least squares unless the loss is l2.
// Reads the working estimates, u_status, geometry, sample stack, inputs of penalty.glsl; writes o_estimate, o_status.
//
// The first loop over the observations sums JᵀWJ and JᵀWe (linearise.glsl). The second evaluates the steps of
// DAMPINGS dampings. penalty.glsl adds to the loss: no_penalty.glsl, or the penalty of the prefit or of a prior.

#include "refine/linearise.glsl"
#include "refine/status.glsl"
#include "refine/normal_equations.glsl"
#include "fitness/lobes.glsl"
#include "penalty.glsl"

// Ratio of successive dampings in one iteration, and their bounds. Damping below 2⁻²⁰ is lost in rounding.
#define DAMPING_RATIO 8.0
#define MIN_DAMPING (1.0 / 1048576.0)
#define MAX_DAMPING 1e6

// Longest step of a searched number, as a fraction of its range. Longer steps end in a corner of the box, where a lobe
// has no strength, and so its width has no gradient. From one start, 1 in 15 random principled materials in shadow miss
// their optimum; without the limit 1 in 10. With two lobes the limit makes no difference.
#define MAX_STEP 0.2

// Adds the model's priors to the normal equations, J per range. The derivative of n log(F + NOISE_FLOOR) + D equals
// that of n F + (F + NOISE_FLOOR) D, divided by F + NOISE_FLOOR. JᵀWJ and JᵀWe are half the second and half the first
// derivative of the loss, times δ². For l1 they are the whole derivatives.
void add_priors(ivec2 texel, inout float c[MAX_COMPONENTS], float fitness, inout float a[FREE_COUNT * FREE_COUNT],
                inout float gradient[FREE_COUNT])
{
#if PRIORS > 0
    float inverse_delta = inverse_delta_of(radiance_scale_at(texel));
#if LOSS == LOSS_L1
    float unit = 2.0 * (fitness + NOISE_FLOOR) / (inverse_delta * inverse_delta);
#else
    float unit = (fitness + NOISE_FLOOR) / (inverse_delta * inverse_delta);
#endif
    float prior_gradient[MAX_COMPONENTS];
    float prior_curvature[MAX_COMPONENTS];
    prior_derivatives(c, prior_gradient, prior_curvature);
    for (int u = 0; u < FREE_COUNT; u++) {
        FreeParameter free = free_at(u);
        a[u * FREE_COUNT + u] += unit * free.width * free.width * prior_curvature[free.at];
        gradient[u] += unit * free.width * prior_gradient[free.at];
    }
#endif
}

// Computes the components c after a step delta of all free parameters. The normal stays in its hemisphere.
void take_step(inout float unmoved[MAX_COMPONENTS], inout float delta[FREE_COUNT], out float c[MAX_COMPONENTS])
{
    for (int i = 0; i < MAX_COMPONENTS; i++) {
        c[i] = unmoved[i];
    }
    for (int u = 0; u < FREE_COUNT; u++) {
        FreeParameter free = free_at(u);
        if (is_normal(u)) {
            continue;
        }
        c[free.at] = clamp(c[free.at] + delta[u] * free.width, free.low, free.low + free.width);
    }
#if NORMAL_FREE >= 0
    FreeParameter free = free_at(NORMAL_FREE);
    vec3 n = vec3(c[free.at], c[free.at + 1], c[free.at + 2]);
    n = turned_normal(n, free.width * vec2(delta[NORMAL_FREE], delta[NORMAL_FREE + 1]));
    n = normalize(vec3(n.xy, max(n.z, 0.0)));
    c[free.at] = n.x;
    c[free.at + 1] = n.y;
    c[free.at + 2] = n.z;
#endif
}

void improve(ivec2 texel, inout float c[MAX_COMPONENTS], inout Status status)
{
    Texel t = observed_texel(texel);
    float a[FREE_COUNT * FREE_COUNT];
    float gradient[FREE_COUNT];
    vec2 loss_and_weight = linearise(t, c, a, gradient);
    add_penalty(texel, c, a, gradient);
    float fitness = (loss_and_weight.x + penalty_of(texel, c)) / (3.0 * loss_and_weight.y);
    float fitness_before = with_priors(fitness, loss_and_weight.y, material_from(c));
    add_priors(texel, c, fitness, a, gradient);
    status.evaluations += float(EVALUATIONS);
    // Stops at NaN as well: a texel without a fitness cannot improve.
    if (!(loss_and_weight.y > 0.0 && fitness_before < UNFIT)) {
        status.fitness = UNFIT;
        status.stalled = CONVERGED_AFTER;
        return;
    }
    float norm[FREE_COUNT];
    float lower[FREE_COUNT];
    float upper[FREE_COUNT];
    for (int i = 0; i < FREE_COUNT; i++) {
        norm[i] = sqrt(a[i * FREE_COUNT + i]);
        vec2 bounds = step_bounds(c, i);
        lower[i] = searched(i) ? max(bounds.x, -MAX_STEP) : bounds.x;
        upper[i] = searched(i) ? min(bounds.y, MAX_STEP) : bounds.y;
    }
    for (int i = 0; i < FREE_COUNT; i++) {
        gradient[i] = norm[i] > 0.0 ? gradient[i] / norm[i] : 0.0;
        for (int k = i; k < FREE_COUNT; k++) {
            float norms = norm[i] * norm[k];
            a[i * FREE_COUNT + k] = norms > 0.0 ? a[i * FREE_COUNT + k] / norms : 0.0;
        }
    }
    Material candidates[DAMPINGS];
    float dampings[DAMPINGS];
    float step_size[DAMPINGS];
    float sum[DAMPINGS];
    float next_damping = status.damping / DAMPING_RATIO;
    for (int p = 0; p < DAMPINGS; p++) {
        dampings[p] = clamp(next_damping, MIN_DAMPING, MAX_DAMPING);
        next_damping *= DAMPING_RATIO;
        float delta[FREE_COUNT];
        boxed_step(a, gradient, norm, dampings[p], lower, upper, delta);
        step_size[p] = 0.0;
        for (int u = 0; u < FREE_COUNT; u++) {
            step_size[p] = max(step_size[p], abs(delta[u]));
        }
        float candidate[MAX_COMPONENTS];
        take_step(c, delta, candidate);
        candidates[p] = material_from(candidate);
        sum[p] = penalty_of(texel, candidate);
    }
    float inverse_delta = inverse_delta_of(t.radiance_scale);
    Observation o;
    EACH_OBSERVATION(t, o) {
        float scale_over_delta = inverse_delta * error_scale(t, o);
        for (int p = 0; p < DAMPINGS; p++) {
            vec3 error = error_of(o, reflectance(candidates[p], o.l, o.v));
            sum[p] += weighted_loss(o, error, scale_over_delta);
        }
    }
    int chosen = -1;
    float best_fitness = fitness_before;
    for (int p = 0; p < DAMPINGS; p++) {
        float fitness = with_priors(sum[p] / (3.0 * loss_and_weight.y), loss_and_weight.y, candidates[p]);
        if (fitness < best_fitness) {
            best_fitness = fitness;
            chosen = p;
        }
    }
    float gain = (fitness_before - best_fitness) / fitness_before;
    status.fitness = best_fitness;
    if (chosen < 0) {
        // No step was better: the next damping exceeds all that were tried.
        status.damping = min(dampings[DAMPINGS - 1] * DAMPING_RATIO * DAMPING_RATIO, MAX_DAMPING);
        status.stalled += 1.0;
        return;
    }
    for (int p = 0; p < DAMPINGS; p++) {
        if (p == chosen) {
            material_to(candidates[p], c);
            order_lobes(c);
            status.damping = dampings[p];
            status.stalled = gain < FTOL || step_size[p] < XTOL ? status.stalled + 1.0 : 0.0;
        }
    }
}

bool texel_kernel(ivec2 texel)
{
    float c[MAX_COMPONENTS];
    material_to(estimate_at(texel), c);
    Status status = status_from(texelFetch(u_status, texel, 0));
#ifdef RACE_RATIO
    // In the race, after the first steps from a start, a texel stops that is far behind its best material so far.
    float best_fitness = status_from(texelFetch(u_best_status, texel, 0)).fitness;
    if (u_races != 0 && !(status.fitness + NOISE_FLOOR < RACE_RATIO * (best_fitness + NOISE_FLOOR))) {
        status.stalled = CONVERGED_AFTER;
    }
#endif
    if (state_at(texel) == TEXEL_SOLVED && status.stalled < CONVERGED_AFTER) {
        improve(texel, c, status);
        // Convergence does not count while δ still changes (u_settles = 0).
        status.stalled = u_settles != 0 ? status.stalled : 0.0;
    }
    write_estimate(c);
    o_status = stored_status(status);
    return true;
}
