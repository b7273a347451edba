// Eq. 1 of the paper: the mean loss between render and reference over all observations of a texel.
// Reads u_stack (one layer an observation: RGB radiance, weight) and the observation table.

#include "material.glsl"
#include "model.glsl"
#include "fitness/error_scale.glsl"
#include "fitness/unfit.glsl"
#include "fitness/with_priors.glsl"

// Returns the fitness. weights: the sum of the samples' weights.
float fitness_of(Texel t, Material s, out float weights)
{
    float sum = 0.0;
    weights = 0.0;
    float inverse_delta = inverse_delta_of(t.radiance_scale);
    Observation o;
    EACH_OBSERVATION(t, o) {
        vec3 render = reflectance(s, o.l, o.v);
#ifdef GREY
        // Compares a coloured model with grey samples, over the channels that these are made of. A grey bound is one of
        // the mean, so the mean precedes the error.
        render = vec3(dot(o.lit_channels, render) / dot(o.lit_channels, vec3(1.0)));
#endif
        vec3 error = error_of(o, render);
        sum += weighted_loss(o, error, inverse_delta * error_scale(t, o));
        weights += o.weight;
    }
    float mean = sum / (3.0 * weights);
    // NaN becomes UNFIT: it must never become a best.
    return weights > 0.0 && mean < UNFIT ? mean : UNFIT;
}
