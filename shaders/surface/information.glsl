// Over W×H texels: what the samples say of the normal, as slopes. Their covariance is that of the normal in the normal
// equations over the noise, with the linear parameters free: the Schur complement, inverted.
// Reads the estimates, the sample stack, u_noise, geometry and packing.
// Writes o_field: (slopes along x and y, 0, 0), and o_covariance: (xx, xy, yy, 1 where the texel begins a loop).

#include "common/estimate.glsl"
#include "surface/normal_matrix.glsl"
#include "surface/slopes.glsl"

// The covariance (xx, xy, yy) of the normal's two angles.
vec3 covariance_of_angles(ivec2 texel, inout float c[12])
{
    float a[FREE_COUNT * FREE_COUNT];
    float noise = eliminated(texel, c, a);
    int at = NORMAL_FREE * FREE_COUNT + NORMAL_FREE;
    // Not below the prior's: the rest of an elimination is rounding.
    float xx = max(a[at], noise);
    float yy = max(a[at + FREE_COUNT + 1], noise);
    float xy = clamp(a[at + 1], -0.999 * sqrt(xx * yy), 0.999 * sqrt(xx * yy));
    float width = free_at(NORMAL_FREE).width;
    return noise * width * width / (xx * yy - xy * xy) * vec3(yy, -xy, xx);
}

// Whether the texel, the next ones in x and y and the one beyond both are one piece of the surface.
bool begins_loop(ivec4 place)
{
    return joined_at(place, ivec2(1, 0)).x >= 0 && joined_at(place, ivec2(0, 1)).x >= 0 &&
           joined_at(place, ivec2(1, 1)).x >= 0;
}

bool texel_kernel(ivec2 texel)
{
    o_field = vec4(0.0);
    o_covariance = vec4(0.0);
    if (state_at(texel) != TEXEL_SOLVED) {
        return true;
    }
    float c[12];
    material_to(estimate_at(texel), c);
    vec3 n = vec3(c[NORMAL_COMPONENT], c[NORMAL_COMPONENT + 1], c[NORMAL_COMPONENT + 2]);
    Grid g = grid_at(texel);
    float area = abs(g.step_x.x * g.step_y.y - g.step_x.y * g.step_y.x);
    // Also skips NaN, of steps along one line.
    if (!(area > 0.0)) {
        return true;
    }
    // A normal that faces less has no finite slope, and stays.
    vec3 angles = facing_of(g, n) > LEAST_FACING ? covariance_of_angles(texel, c) : vec3(0.0);
    vec3 axis = turning_axis(n);
    vec2 first = slopes_by(g, n, axis);
    vec2 second = slopes_by(g, n, cross(n, axis));
    vec2 once = angles.x * first + angles.y * second;
    vec2 twice = angles.y * first + angles.z * second;
    o_field.xy = slopes_of(g, n);
    o_covariance.xyz = vec3(once.x * first.x + twice.x * second.x, once.x * first.y + twice.x * second.y,
                            once.y * first.y + twice.y * second.y);
    o_covariance.w = begins_loop(surface_place_of(texel)) ? 1.0 : 0.0;
    return true;
}
