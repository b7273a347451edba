// Over W×H texels: how much worse the best alternative far from the estimate fits, for every searched number without a
// normal prior. The number takes TRIALS values of its range; the linear weights are solved again for each
// (fitness/linear.glsl); everything else is fixed.
// Reads the estimates, the geometry, the sample stack and the observation table. Writes o_alternative, one each
// for the ALTERNATIVES such numbers: −2 log of the ratio of the likelihoods, −MOST to MOST, below 0 where the alternative
// fits better.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"
#include "fitness/linear.glsl"
#include "diagnostics/freedom.glsl"
#include "free_parameters.glsl"

#define TRIALS 7
// As a fraction of the range: a nearer value belongs to the same optimum.
#define FAR 0.3
// Three standard deviations of one texel: a single wrong one must not outvote its material (solver/engine/modes.py).
#define MOST 9.0

// Values to try, as fractions of the range: denser where lobes are narrow and differ more.
float trial_at(int i)
{
    return i < 4 ? (i < 2 ? (i == 0 ? 0.01 : 0.04) : (i == 2 ? 0.1 : 0.25)) : (i == 4 ? 0.5 : (i == 5 ? 0.75 : 1.0));
}

// The number of independent samples beyond those that determine all parameters.
float samples_left(Texel t, Material best)
{
    ErrorSums sums;
    clear_errors(sums);
    Observation o;
    EACH_OBSERVATION(t, o) {
        vec3 error = error_of(o, reflectance(best, o.l, o.v));
        float relative = relative_error(t, o);
        vec3 counted = o.weight * active_channels(o, error);
        add_error(sums, error, relative * relative * counted, counted);
    }
    return max(freedom_of(sums), 0.0) / alike_of(sums);
}

// Sets the linear weights of s to the best fit, with each sample's weight from the errors of ``best``.
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
        add_observation(e, s, o, reweighted(t, o, error, relative_error(t, o)));
    }
    solve_linear(e, w);
    linear_to(w, s);
#endif
}

bool texel_kernel(ivec2 texel)
{
    float worse[12];  // with room for all that a model can have
    for (int i = 0; i < 12; i++) {
        worse[i] = 0.0;
    }
    if (state_at(texel) == TEXEL_SOLVED) {
        Texel t = observed_texel(texel);
        Material best = estimate_at(texel);
        float c[12];
        material_to(best, c);
        float left = samples_left(t, best);
        float weights;
        float fitness = fitness_of(t, best, weights);
        int place = 0;
        for (int u = 0; u < FREE_COUNT; u++) {
            FreeParameter free = free_at(u);
            if (!searched(u) || prior_precision(c, free.at) > 0.0) {
                continue;
            }
            float own = c[free.at];
            float lowest = UNFIT;
            for (int i = 0; i < TRIALS; i++) {
                float value = free.low + trial_at(i) * free.width;
                if (abs(value - own) < FAR * free.width) {
                    continue;
                }
                c[free.at] = value;
                Material s = material_from(c);
                refit(t, best, s);
                lowest = min(lowest, fitness_of(t, s, weights));
            }
            c[free.at] = own;
            worse[place] = clamp(left * log((lowest + NOISE_FLOOR) / (fitness + NOISE_FLOOR)), -MOST, MOST);
            place++;
        }
    }
    write_alternative(worse);
    return true;
}
