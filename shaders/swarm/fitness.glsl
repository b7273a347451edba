// Eq. 1 of the paper: how far the render of a material lies from the reference, over all observations of a texel.
// Reads u_stack (one layer an observation: RGB radiance, weight) and the observation table.

#include "common/observation.glsl"
#include "material.glsl"
#include "model.glsl"
#include "swarm/loss.glsl"
#include "swarm/unfit.glsl"

float fitness_of(ivec2 texel, Frame f, Material s)
{
    float sum = 0.0;
    float weights = 0.0;
    float scale = loss_scale(texel);
#ifdef ONE_VIEW
    vec3 v = view_at(f, 0);
#endif
    for (int k = 0; k < u_observations; k++) {
        vec3 l;
        vec3 intensity;
        vec3 radiance;
        float weight = observe(texel, f, k, l, intensity, radiance);
        if (weight == 0.0) {
            continue;
        }
#ifndef ONE_VIEW
        vec3 v = view_at(f, k);
#endif
        vec3 error = intensity * reflectance(s, l, v) - radiance;
#ifdef GREY
        // Of a model in colour it is the grey that is compared.
        error = vec3((error.r + error.g + error.b) / 3.0);
#endif
        sum += weight * loss_of(scale * error);
        weights += weight;
    }
    float mean = sum / (3.0 * weights);
    // Written so that NaN is unfit too: it must never become a best.
    return weights > 0.0 && mean < UNFIT ? mean : UNFIT;
}
