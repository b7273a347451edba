// The normal that mirrors the light of the brightest sample: the centre of a dominant lobe. Reads the samples.

#include "common/observation.glsl"

#ifdef NORMAL_COMPONENT
// Turns the normal in c to the half vector of the sample that is brightest relative to its light's intensity. Without a
// sample in front of the surface the normal stays.
void turn_to_mirror(ivec2 texel, inout float c[12])
{
    float most = 0.0;
    Texel t = observed_texel(texel);
    Observation o;
    EACH_OBSERVATION(t, o) {
        vec3 has = vec3(greaterThan(o.intensity, vec3(0.0)));
        float bright = dot(has * o.radiance, 1.0 / mix(vec3(1.0), o.intensity, has)) / max(dot(has, vec3(1.0)), 1.0);
        vec3 between = o.l + o.v;
        if (bright > most && between.z > 0.0) {
            most = bright;
            vec3 n = normalize(between);
            c[NORMAL_COMPONENT] = n.x;
            c[NORMAL_COMPONENT + 1] = n.y;
            c[NORMAL_COMPONENT + 2] = n.z;
        }
    }
}
#endif
