// Over W×H texels: the estimates with the values of start u_start put in (−1: as they are), to be polished. A start may
// turn the normal to where it mirrors the brightest sample's light: there is the middle of a lobe that is most of what a
// texel reflects. Reads the estimates, u_status and the samples. What this tile does not solve stays as it is.

#include "common/observation.glsl"
#include "swarm/polish_state.glsl"
#include "starts.glsl"

// Returns the half vector of the observation that is brightest for its light's intensity, else the normal given.
vec3 mirror_of(ivec2 texel, vec3 normal)
{
    Frame f = frame_at(texel);
    float most = 0.0;
    for (int k = 0; k < u_observations; k++) {
        Observation o;
        if (!observe(texel, f, k, o)) {
            continue;
        }
        vec3 has = vec3(greaterThan(o.intensity, vec3(0.0)));
        float bright = dot(has * o.radiance, 1.0 / mix(vec3(1.0), o.intensity, has)) / max(dot(has, vec3(1.0)), 1.0);
        vec3 between = o.l + view_at(f, k);
        if (bright > most && between.z > 0.0) {
            most = bright;
            normal = normalize(between);
        }
    }
    return normal;
}

bool texel_kernel(ivec2 texel)
{
    float c[12];
    material_to(estimate_at(texel), c);
    if (state_at(texel) == TEXEL_SOLVED) {
        take_start(u_start, c);
#ifdef NORMAL_COMPONENT
        if (mirrors(u_start)) {
            vec3 n = mirror_of(texel, vec3(c[NORMAL_COMPONENT], c[NORMAL_COMPONENT + 1], c[NORMAL_COMPONENT + 2]));
            c[NORMAL_COMPONENT] = n.x;
            c[NORMAL_COMPONENT + 1] = n.y;
            c[NORMAL_COMPONENT + 2] = n.z;
        }
#endif
    }
    write_estimate(material_from(c));
    o_status = fresh_status(texelFetch(u_status, texel, 0).w);
    return true;
}
