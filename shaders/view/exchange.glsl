// Over the elements of a surface: radiance by interreflection. Monte Carlo over the rays of geometry/light/exchange.py,
// whose density is cos/π. Writes o_radiance. u_to_camera = 1: radiance toward the camera of observation u_observation,
// by light of other elements; in alpha by direct light, mean of the channels. u_to_camera = 0: mean over all
// directions, with the light of each ray leaving in the direction of another ray.
// Reads estimates, geometry and observation table; u_rays, one layer per ray: direction in world space and the element
// that it hits (−1: none); u_lit: fraction of the light that reaches an element; u_received: the mean of the previous
// bounces. An element's indirect light is this mean if u_branches = 0, else from u_branches rays: a lobe does not send
// the mean.

#include "common/estimate.glsl"
#include "common/observation.glsl"
#include "model.glsl"

// Upper limit of a ray's radiance for light of intensity 1. Without it, rays that hit a narrow highlight, or lie in a
// narrow lobe, leave isolated bright elements (fireflies).
#define MAX_RADIANCE 64.0

// Returns the radiance of an element toward a direction by direct light, times the throughput of the receiver.
vec3 direct_radiance(ivec2 element, vec3 toward, vec3 throughput)
{
    float lit = texelFetch(u_lit, element, 0).r;
    if (lit == 0.0) {
        return vec3(0.0);
    }
    Frame f = frame_at(element);
    vec3 intensity;
    vec3 l = light_at(f, u_observation, intensity);
    vec3 reflected = throughput * reflectance(estimate_at(element), l, to_local(f, toward));
    return lit * intensity * min(reflected, vec3(MAX_RADIANCE));
}

// Returns the throughput: the factor from the radiance along a ray (l) to radiance toward v.
vec3 throughput_of(Material s, vec3 l, vec3 v)
{
    return min(reflectance(s, l, v) / max(l.z, 1e-4), vec3(MAX_RADIANCE));
}

ivec2 texel_of_element(int element)
{
    return ivec2(element % u_columns, element / u_columns);
}

// Returns the radiance of an element toward a direction by indirect light, from u_branches rays beginning at ``first``.
vec3 indirect_radiance(ivec2 element, vec3 toward, int first)
{
    Frame f = frame_at(element);
    Material s = estimate_at(element);
    vec3 v = to_local(f, toward);
    vec3 sum = vec3(0.0);
    for (int r = 0; r < u_branches; r++) {
        vec4 ray = texelFetch(u_rays, ivec3(element, (first + r) % u_ray_count), 0);
        int hit = int(ray.w);
        if (hit >= 0) {
            vec3 throughput = throughput_of(s, to_local(f, ray.xyz), v);
            ivec2 other = texel_of_element(hit);
            sum += throughput * texelFetch(u_received, other, 0).rgb + direct_radiance(other, -ray.xyz, throughput);
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
        vec3 throughput = throughput_of(s, to_local(f, ray.xyz), v);
        vec3 indirect = u_branches > 0 ? indirect_radiance(other, -ray.xyz, r * u_branches)
                                       : texelFetch(u_received, other, 0).rgb;
        sum += min(throughput * indirect, vec3(MAX_RADIANCE)) + direct_radiance(other, -ray.xyz, throughput);
    }
    vec3 direct = u_to_camera == 0 ? vec3(0.0) : direct_radiance(texel, to_world(f, v), vec3(1.0));
    o_radiance = vec4(sum / float(u_ray_count), dot(direct, vec3(1.0 / 3.0)));
    return true;
}
