// Turns the normal to the half vector of the brightest sample, the centre of a dominant lobe. Reads the samples.

#include "common/observation.glsl"

#ifdef NORMAL_COMPONENT
// level is the radiance over the light's intensity. If no half vector is in front of the surface, the normal stays.
void turn_to_mirror(ivec2 texel, inout float c[MAX_COMPONENTS])
{
    float brightest = 0.0;
    Texel t = observed_texel(texel);
    Observation o;
    EACH_OBSERVATION(t, o) {
        vec3 lit = vec3(greaterThan(o.intensity, vec3(0.0)));
        float level = dot(lit * o.radiance, 1.0 / mix(vec3(1.0), o.intensity, lit)) / max(dot(lit, vec3(1.0)), 1.0);
        vec3 half_vector = o.l + o.v;
        if (level > brightest && half_vector.z > 0.0) {
            brightest = level;
            vec3 n = normalize(half_vector);
            c[NORMAL_COMPONENT] = n.x;
            c[NORMAL_COMPONENT + 1] = n.y;
            c[NORMAL_COMPONENT + 2] = n.z;
        }
    }
}
#endif
