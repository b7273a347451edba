// Mean absolute error of a material's render at a texel. The samples have their weights in the fitness; its
// loss does not matter.

#include "common/observation.glsl"
#include "material.glsl"
#include "model.glsl"

// Returns (mean absolute error over channels and weighted samples, sum of weights, largest error, 0).
vec4 mean_error(ivec2 texel, Material s)
{
    float sum = 0.0;
    float weights = 0.0;
    float largest = 0.0;
    Texel t = observed_texel(texel);
    Observation o;
    EACH_OBSERVATION(t, o) {
        vec3 error = abs(error_of(o, reflectance(s, o.l, o.v)));
        sum += o.weight * (error.r + error.g + error.b);
        weights += o.weight;
        largest = max(largest, max(error.r, max(error.g, error.b)));
    }
    return vec4(weights > 0.0 ? sum / (3.0 * weights) : 0.0, weights, largest, 0.0);
}
