// Eq. 1 of the paper: how far the render of a material lies from the reference, over all observations of a texel.
// Reads u_stack (one layer an observation: RGB radiance, weight) and the observation table.

#include "common/observation.glsl"
#include "material.glsl"
#include "model.glsl"

#define FITNESS_L1 0
#define FITNESS_L2 1
#define FITNESS_ROBUST 2

// No render is this far off; also the fitness of a texel that no observation sees.
#define UNFIT 1e30

float fitness_of(ivec2 texel, Frame f, Material s)
{
    float sum = 0.0;
    float weights = 0.0;
#if FITNESS == FITNESS_ROBUST
    float scale = 1.0 / (scale_at(texel) * u_delta);
#endif
#ifdef ONE_VIEW
    vec3 v = view_at(f, 0);
#endif
    for (int k = 0; k < u_observations; k++) {
        vec4 reference = texelFetch(u_stack, ivec3(texel, k), 0);
        if (reference.a <= 0.0) {
            continue;
        }
        vec3 intensity;
        vec3 l = light_at(f, k, intensity);
#ifndef ONE_VIEW
        vec3 v = view_at(f, k);
#endif
        vec3 error = intensity * reflectance(s, l, v) - reference.rgb;
#if FITNESS == FITNESS_L1
        error = abs(error);
#elif FITNESS == FITNESS_L2
        error = error * error;
#else
        // Cauchy's loss: a sample in cast shadow or on a reflection costs little more however wrong it is.
        error *= scale;
        error = log(1.0 + error * error);
#endif
        sum += reference.a * (error.r + error.g + error.b);
        weights += reference.a;
    }
    float mean = sum / (3.0 * weights);
    // Written so that NaN is unfit too: it must never become a best.
    return weights > 0.0 && mean < UNFIT ? mean : UNFIT;
}
