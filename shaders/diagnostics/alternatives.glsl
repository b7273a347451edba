// Over W×H texels: compares the estimate with distant alternatives, for every searched number without a normal prior.
// The number takes TRIALS values of its range, each with the linear weights solved again (fitness/linear.glsl) and all
// other parameters fixed. Reads the estimates, the geometry, the sample stack and the observation table.
// Writes o_alternative, one value for each of the ALTERNATIVES numbers: −2 log of the likelihood ratio of the best
// alternative to the estimate, clamped to ±MAX_DEVIANCE. It is negative where the alternative fits better.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"
#include "fitness/linear.glsl"
#include "diagnostics/freedom.glsl"
#include "free_parameters.glsl"

#define TRIALS 7
// Fraction of the range. A value nearer to the estimate belongs to the same optimum.
#define MIN_DISTANCE 0.3
// (3 standard deviations of one texel)²: one wrong texel must not outweigh its material (solver/engine/modes.py).
#define MAX_DEVIANCE 9.0

// Returns trial value i, as a fraction of the range. The values are denser where lobes are narrow and so differ more.
float trial_at(int i)
{
    return i < 4 ? (i < 2 ? (i == 0 ? 0.01 : 0.04) : (i == 2 ? 0.1 : 0.25)) : (i == 4 ? 0.5 : (i == 5 ? 0.75 : 1.0));
}

// Returns the number of independent samples minus the number that determines all parameters.
float independent_samples(Texel t, Material best)
{
    ErrorSums sums;
    clear_errors(sums);
    Observation o;
    EACH_OBSERVATION(t, o) {
        vec3 error = error_of(o, reflectance(best, o.l, o.v));
        float scale = error_scale(t, o);
        vec3 counted = o.weight * active_channels(o, error);
        add_error(sums, error, scale * scale * counted, counted);
    }
    return max(degrees_of_freedom(sums), 0.0) / redundancy_of(sums);
}

// Sets the linear weights of s to the best fit. The weights of the samples follow from the errors of ``best``.
void refit(Texel t, Material best, inout Material s)
{
#if LINEAR_BLOCKS > 0
    Equations e;
    Linear w;
    clear_equations(e);
    clear_linear(w);
    Observation o;
    EACH_OBSERVATION(t, o) {
        vec3 error = error_of(o, reflectance(best, o.l, o.v));
        add_observation(e, s, o, reweighted(t, o, error, error_scale(t, o)));
    }
    solve_linear(e, w);
    linear_to(w, s);
#endif
}

bool texel_kernel(ivec2 texel)
{
    float deviance[MAX_COMPONENTS];
    for (int i = 0; i < MAX_COMPONENTS; i++) {
        deviance[i] = 0.0;
    }
    if (state_at(texel) == TEXEL_SOLVED) {
        Texel t = observed_texel(texel);
        Material best = estimate_at(texel);
        float c[MAX_COMPONENTS];
        material_to(best, c);
        float samples = independent_samples(t, best);
        float weights;
        float fitness = fitness_of(t, best, weights);
        int slot = 0;
        for (int u = 0; u < FREE_COUNT; u++) {
            FreeParameter free = free_at(u);
            if (!searched(u) || prior_precision(c, free.at) > 0.0) {
                continue;
            }
            float estimated = c[free.at];
            float lowest = UNFIT;
            for (int i = 0; i < TRIALS; i++) {
                float value = free.low + trial_at(i) * free.width;
                if (abs(value - estimated) < MIN_DISTANCE * free.width) {
                    continue;
                }
                c[free.at] = value;
                Material s = material_from(c);
                refit(t, best, s);
                lowest = min(lowest, fitness_of(t, s, weights));
            }
            c[free.at] = estimated;
            deviance[slot] =
                clamp(samples * log((lowest + NOISE_FLOOR) / (fitness + NOISE_FLOOR)), -MAX_DEVIANCE, MAX_DEVIANCE);
            slot++;
        }
    }
    write_alternative(deviance);
    return true;
}
