// Over W×H texels: mean absolute difference between the render of the estimates and the references, whatever the
// fitness that was searched. Writes (residual, samples that counted, largest difference, 0).

#include "common/estimate.glsl"
#include "common/observation.glsl"
#include "model.glsl"

bool texel_kernel(ivec2 texel)
{
    o_residual = vec4(0.0);
    if (state_at(texel) != TEXEL_SOLVED) {
        return true;
    }
    Frame f = frame_at(texel);
    Material s = estimate_at(texel);
    float sum = 0.0;
    float weights = 0.0;
    float largest = 0.0;
    for (int k = 0; k < u_observations; k++) {
        vec3 l;
        vec3 intensity;
        vec3 radiance;
        float weight = observe(texel, f, k, l, intensity, radiance);
        if (weight == 0.0) {
            continue;
        }
        vec3 error = abs(intensity * reflectance(s, l, view_at(f, k)) - radiance);
        sum += weight * (error.r + error.g + error.b);
        weights += weight;
        largest = max(largest, max(error.r, max(error.g, error.b)));
    }
    o_residual = vec4(weights > 0.0 ? sum / (3.0 * weights) : 0.0, weights, largest, 0.0);
    return true;
}
