// Over the elements of a surface: the radiance that other elements make each one send to the camera of one observation
// (u_to_camera = 1), or the mean of what they make it send in all directions (0), as what it passes on at the bounces
// before the last: each ray's light goes on in the direction of another ray.
// Monte Carlo over the rays of geometry/light/exchange.py, whose density is cos/π.
// Reads estimates, geometry and observation table; u_rays, one layer a ray: direction in the world and the element that it
// meets, −1 for none; u_lit: whether the light reaches an element; u_received: this pass's result of the bounce before.

#include "common/estimate.glsl"
#include "common/observation.glsl"
#include "model.glsl"

// The most that a ray brings, for light of intensity 1: one that meets a narrow highlight, or lies in a narrow lobe,
// stands for many that do not, and would leave a lone bright element.
#define MOST 64.0

// What an element sends in a direction, times the share that its receiver reflects.
vec3 brought(ivec2 element, vec3 toward, vec3 share)
{
    vec3 passed_on = share * texelFetch(u_received, element, 0).rgb;
    if (texelFetch(u_lit, element, 0).r == 0.0) {
        return passed_on;
    }
    Frame f = frame_at(element);
    vec3 intensity;
    vec3 l = light_at(f, u_observation, intensity);
    return passed_on + intensity * min(share * reflectance(estimate_at(element), l, to_local(f, toward)), vec3(MOST));
}

bool texel_kernel(ivec2 texel)
{
    o_radiance = vec4(0.0);
    if (state_at(texel) == TEXEL_OUTSIDE) {
        return true;
    }
    Frame f = frame_at(texel);
    Material s = estimate_at(texel);
    vec3 v = view_at(f, u_observation);
    vec3 sum = vec3(0.0);
    for (int r = 0; r < u_ray_count; r++) {
        vec4 ray = texelFetch(u_rays, ivec3(texel, r), 0);
        int hit = int(ray.w);
        if (hit < 0) {
            continue;
        }
        vec3 l = to_local(f, ray.xyz);
        if (u_to_camera == 0) {
            v = to_local(f, texelFetch(u_rays, ivec3(texel, u_ray_count - 1 - r), 0).xyz);
        }
        vec3 share = min(reflectance(s, l, v) / max(l.z, 1e-4), vec3(MOST));
        sum += brought(ivec2(hit % u_columns, hit / u_columns), -ray.xyz, share);
    }
    o_radiance = vec4(sum / float(u_ray_count), 1.0);
    return true;
}
