// Over the elements of a surface: the radiance that other elements make each one send to the camera of one observation
// (u_to_camera = 1), and in alpha what the light itself makes it send there, mean of the channels; or the mean of what
// they make it send in all directions (0): each ray's light goes on in the direction of another ray.
// Monte Carlo over the rays of geometry/light/exchange.py, whose density is cos/π.
// Reads estimates, geometry and observation table; u_rays, one layer a ray: direction in the world and the element that
// it meets, −1 for none; u_lit: whether the light reaches an element; u_received: this pass's mean of the bounces
// before. What the elements that a ray meets pass on of the light of others is that mean where u_branches = 0, and else
// what they send toward the ray, from as many rays of their own: lobes do not send the mean.

#include "common/estimate.glsl"
#include "common/observation.glsl"
#include "model.glsl"

// The most that a ray brings, for light of intensity 1: one that meets a narrow highlight, or lies in a narrow lobe,
// stands for many that do not, and would leave a lone bright element.
#define MOST 64.0

// What an element sends of the light of the observation in a direction, times the share that its receiver reflects.
vec3 of_light(ivec2 element, vec3 toward, vec3 share)
{
    if (texelFetch(u_lit, element, 0).r == 0.0) {
        return vec3(0.0);
    }
    Frame f = frame_at(element);
    vec3 intensity;
    vec3 l = light_at(f, u_observation, intensity);
    return intensity * min(share * reflectance(estimate_at(element), l, to_local(f, toward)), vec3(MOST));
}

// Of what a ray brings, the share that goes on toward v.
vec3 throughput_of(Material s, vec3 l, vec3 v)
{
    return min(reflectance(s, l, v) / max(l.z, 1e-4), vec3(MOST));
}

ivec2 texel_of_element(int element)
{
    return ivec2(element % u_columns, element / u_columns);
}

// What an element sends in a direction of the light of others, by rays from number first on.
vec3 passed_on(ivec2 element, vec3 toward, int first)
{
    Frame f = frame_at(element);
    Material s = estimate_at(element);
    vec3 v = to_local(f, toward);
    vec3 sum = vec3(0.0);
    for (int r = 0; r < u_branches; r++) {
        vec4 ray = texelFetch(u_rays, ivec3(element, (first + r) % u_ray_count), 0);
        int hit = int(ray.w);
        if (hit >= 0) {
            vec3 share = throughput_of(s, to_local(f, ray.xyz), v);
            ivec2 other = texel_of_element(hit);
            sum += share * texelFetch(u_received, other, 0).rgb + of_light(other, -ray.xyz, share);
        }
    }
    return sum / float(u_branches);
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
        ivec2 other = texel_of_element(hit);
        if (u_to_camera == 0) {
            v = to_local(f, texelFetch(u_rays, ivec3(texel, u_ray_count - 1 - r), 0).xyz);
        }
        vec3 share = throughput_of(s, to_local(f, ray.xyz), v);
        vec3 others = u_branches > 0 ? passed_on(other, -ray.xyz, r * u_branches) : texelFetch(u_received, other, 0).rgb;
        sum += min(share * others, vec3(MOST)) + of_light(other, -ray.xyz, share);
    }
    vec3 direct = u_to_camera == 0 ? vec3(0.0) : of_light(texel, to_world(f, v), vec3(1.0));
    o_radiance = vec4(sum / float(u_ray_count), dot(direct, vec3(1.0 / 3.0)));
    return true;
}
