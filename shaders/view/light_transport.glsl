// Over the elements of a surface: radiance by interreflection in LIGHTS observations of one camera at once, from
// u_observation on. Monte Carlo over the rays of geometry/light/light_transport.py, whose density is cos/π.
// Writes o_radiance. u_to_camera = 1: radiance toward the camera, by light of other elements; in alpha by direct
// light, mean of the channels. u_to_camera = 0: mean over all directions, with the light of each ray leaving in the
// direction of another.
// Reads estimates, geometry and observation table; u_rays, one layer per ray: direction in world space, as long as this
// cosine, and the element that it hits (−1: none), hits first, and a last layer with their number; u_lit:
// fractions of the lights that reach an element; u_received: the means of the previous bounces. An element's indirect
// light is this mean if u_branches = 0, else from u_branches rays: a lobe does not send the mean.

#include "common/estimate.glsl"
#include "common/observation.glsl"
#include "model.glsl"

// Upper limit of a ray's radiance for light of intensity 1; the intensities given here are about that. Without it, rays
// that hit a narrow highlight, or lie in a narrow lobe, leave isolated bright elements (fireflies).
#define MAX_RADIANCE 64.0
#define GOLDEN_RATIO 0.6180339887

ivec2 texel_of_element(int element)
{
    return ivec2(element % u_columns, element / u_columns);
}

int hits_of(ivec2 element)
{
    return int(texelFetch(u_rays, ivec3(element, u_ray_count), 0).r);
}

void received_at(ivec2 element, out vec3 received[LIGHTS])
{
    float c[4 * LIGHTS];
    read_received(element, c);
    for (int j = 0; j < LIGHTS; j++) {
        received[j] = vec3(c[4 * j], c[4 * j + 1], c[4 * j + 2]);
    }
}

// Returns the throughput: the factor from the radiance along a ray to radiance toward v.
vec3 throughput_of(Frame f, Material s, vec3 ray, vec3 v)
{
    return min(reflectance(s, to_local(f, normalize(ray)), v) / max(length(ray), 1e-4), vec3(MAX_RADIANCE));
}

// Adds the radiances of an element toward a direction by direct light, times the throughput of the receiver.
void add_direct(ivec2 element, vec3 toward, vec3 throughput, inout vec3 sums[LIGHTS])
{
    vec4 lit = texelFetch(u_lit, element, 0);
    if (all(equal(lit, vec4(0.0)))) {
        return;
    }
    Frame f = frame_at(element);
    Material s = estimate_at(element);
    vec3 v = to_local(f, toward);
    for (int j = 0; j < LIGHTS; j++) {
        if (lit[j] == 0.0) {
            continue;
        }
        vec3 intensity;
        vec3 l = light_at(f, u_observation + j, intensity);
        vec3 reflected = throughput * reflectance(s, l, v);
        sums[j] += lit[j] * intensity * min(reflected, vec3(MAX_RADIANCE));
    }
}

// Adds the radiances of an element toward a direction by indirect light, times a throughput.
// first: the first of u_branches rays among those that hit.
void add_indirect(ivec2 element, vec3 toward, int first, vec3 throughput, inout vec3 sums[LIGHTS])
{
    vec3 received[LIGHTS];
    if (u_branches == 0) {
        received_at(element, received);
        for (int j = 0; j < LIGHTS; j++) {
            sums[j] += min(throughput * received[j], vec3(MAX_RADIANCE));
        }
        return;
    }
    int hits = hits_of(element);
    if (hits == 0) {
        return;
    }
    Frame f = frame_at(element);
    Material s = estimate_at(element);
    vec3 v = to_local(f, toward);
    vec3 own[LIGHTS];
    for (int j = 0; j < LIGHTS; j++) {
        own[j] = vec3(0.0);
    }
    for (int b = 0; b < u_branches; b++) {
        vec4 ray = texelFetch(u_rays, ivec3(element, (first + b) % hits), 0);
        ivec2 other = texel_of_element(int(ray.w));
        vec3 through = throughput_of(f, s, ray.xyz, v);
        received_at(other, received);
        for (int j = 0; j < LIGHTS; j++) {
            own[j] += through * received[j];
        }
        add_direct(other, -normalize(ray.xyz), through, own);
    }
    float share = float(hits) / float(u_ray_count * u_branches);
    for (int j = 0; j < LIGHTS; j++) {
        sums[j] += min(throughput * share * own[j], vec3(MAX_RADIANCE));
    }
}

bool texel_kernel(ivec2 texel)
{
    vec3 sums[LIGHTS];
    vec3 direct[LIGHTS];
    for (int j = 0; j < LIGHTS; j++) {
        sums[j] = vec3(0.0);
        direct[j] = vec3(0.0);
    }
    if (state_at(texel) != TEXEL_OUTSIDE) {
        Frame f = frame_at(texel);
        Material s = estimate_at(texel);
        vec3 v = view_at(f, u_observation);
        int hits = hits_of(texel);
        for (int r = 0; r < hits; r++) {
            vec4 ray = texelFetch(u_rays, ivec3(texel, r), 0);
            ivec2 other = texel_of_element(int(ray.w));
            if (u_to_camera == 0) {
                int leaving = int(fract(float(r + 1) * GOLDEN_RATIO) * float(u_ray_count));
                v = to_local(f, normalize(texelFetch(u_rays, ivec3(texel, leaving), 0).xyz));
            }
            vec3 throughput = throughput_of(f, s, ray.xyz, v);
            vec3 toward = -normalize(ray.xyz);
            add_indirect(other, toward, r * u_branches, throughput, sums);
            add_direct(other, toward, throughput, sums);
        }
        if (u_to_camera != 0) {
            add_direct(texel, to_world(f, v), vec3(1.0), direct);
        }
    }
    float c[4 * LIGHTS];
    for (int j = 0; j < LIGHTS; j++) {
        sums[j] /= float(u_ray_count);
        c[4 * j] = sums[j].r;
        c[4 * j + 1] = sums[j].g;
        c[4 * j + 2] = sums[j].b;
        c[4 * j + 3] = dot(direct[j], vec3(1.0 / 3.0));
    }
    write_radiance(c);
    return true;
}
