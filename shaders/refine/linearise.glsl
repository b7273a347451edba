// Normal equations of a material's samples. The derivative by a linear parameter is its basis, the others are finite
// differences. jacobian.glsl holds both; solver/kernels/free_parameters.py generates it.

#include "fitness/fitness.glsl"
#include "fitness/differences.glsl"
#include "jacobian.glsl"

// Sums a = JᵀWJ (upper triangle; J per range) and gradient = JᵀWe. Returns the sums of the losses and of the weights.
vec2 linearise(Texel t, inout float c[MAX_COMPONENTS], out float a[FREE_COUNT * FREE_COUNT],
               out float gradient[FREE_COUNT])
{
    Material s = material_from(c);
    Steps steps;
    steps.none = 0.0;
    take_steps(c, steps);
    NormalSums sums;
    clear_sums(sums);
    float inverse_delta = inverse_delta_of(t.radiance_scale);
    float loss = 0.0;
    float weights = 0.0;
    Observation o;
    EACH_OBSERVATION(t, o) {
        vec3 render = reflectance(s, o.l, o.v);
        vec3 error = error_of(o, render);
        float scale = error_scale(t, o);
        loss += weighted_loss(o, error, inverse_delta * scale);
        weights += o.weight;
        vec3 weight = reweighted(t, o, error, scale) * o.intensity;
        add_jacobian(s, steps, render, o.l, o.v, weight * error, weight * o.intensity, sums);
    }
    for (int i = 0; i < FREE_COUNT * FREE_COUNT; i++) {
        a[i] = 0.0;
    }
    sums_to(sums, a, gradient);
    return vec2(loss, weights);
}
