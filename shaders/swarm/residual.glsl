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
        vec4 reference = texelFetch(u_stack, ivec3(texel, k), 0);
        if (reference.a <= 0.0) {
            continue;
        }
        vec3 intensity;
        vec3 l = light_at(f, k, intensity);
        vec3 error = abs(intensity * reflectance(s, l, view_at(f, k)) - reference.rgb);
        sum += reference.a * (error.r + error.g + error.b);
        weights += reference.a;
        largest = max(largest, max(error.r, max(error.g, error.b)));
    }
    o_residual = vec4(weights > 0.0 ? sum / (3.0 * weights) : 0.0, weights, largest, 0.0);
    return true;
}
