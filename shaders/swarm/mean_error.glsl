// How far the render of a material lies from the references of a texel, whatever the fitness that was searched.

#include "common/observation.glsl"
#include "material.glsl"
#include "model.glsl"

// Returns (mean absolute difference over channels and weighted samples, weights, largest difference, 0).
vec4 mean_error(ivec2 texel, Material s)
{
    Frame f = frame_at(texel);
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
    return vec4(weights > 0.0 ? sum / (3.0 * weights) : 0.0, weights, largest, 0.0);
}
