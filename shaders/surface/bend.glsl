// Over W×H texels: sets the normals to those of the final slopes (settle.glsl, smooth.glsl). The linear parameters move
// to their optimum for the new normal, to first order. If the deviance rises by more than TOLERANCE², the estimate
// stays. Reads the estimates, the samples, u_noise (x: loss of the estimate), u_field, u_covariance and geometry.
// Writes o_estimate.

#include "common/estimate.glsl"
#include "surface/normal_matrix.glsl"
#include "surface/slopes.glsl"
#include "spatial_prior/loss_unit.glsl"

// Sets the normal n in c and moves the linear parameters to their optimum for it.
void set_normal(ivec2 texel, vec3 n, inout float c[MAX_COMPONENTS])
{
    float a[FREE_COUNT * FREE_COUNT];
    eliminate_all_but_normal(texel, c, a);
    int component = NORMAL_COMPONENT;
    vec3 before = vec3(c[component], c[component + 1], c[component + 2]);
    vec3 axis = turning_axis(before);
    vec2 delta = vec2(dot(n, axis), dot(n, cross(before, axis))) / (dot(n, before) * free_at(NORMAL_FREE).width);
    for (int u = 0; u < FREE_COUNT; u++) {
        if (!is_normal(u)) {
            FreeParameter free = free_at(u);
            int entry = u * FREE_COUNT + NORMAL_FREE;
            float moved_by = -free.width * dot(vec2(a[entry], a[entry + 1]), delta);
            c[free.at] = clamp(c[free.at] + moved_by, free.low, free.low + free.width);
        }
    }
    c[component] = n.x;
    c[component + 1] = n.y;
    c[component + 2] = n.z;
}

// Returns whether the deviance of c exceeds the estimate's by at most TOLERANCE².
bool fits_samples(ivec2 texel, inout float c[MAX_COMPONENTS])
{
    vec4 noise = texelFetch(u_noise, texel, 0);
    float weights;
    float fitness = fitness_of(observed_texel(texel), material_from(c), weights);
    return 3.0 * weights * fitness <= (noise.x + TOLERANCE * TOLERANCE * deviance_unit(noise.w)) * loss_unit(texel);
}

bool texel_kernel(ivec2 texel)
{
    float c[MAX_COMPONENTS];
    material_to(estimate_at(texel), c);
    vec3 covariance = texelFetch(u_covariance, texel, 0).xyz;
    if (state_at(texel) == TEXEL_SOLVED && covariance.x + covariance.z > 0.0) {
        set_normal(texel, normal_of(grid_at(texel), texelFetch(u_field, texel, 0).xy), c);
        if (!fits_samples(texel, c)) {
            material_to(estimate_at(texel), c);
        }
    }
    write_estimate(c);
    return true;
}
