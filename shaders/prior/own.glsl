// How well a texel's own samples tell its numbers: u_own_0 …, the standard deviations, packed as the estimates are.

void own_at(ivec2 texel, out float c[12])
{
    vec4 part = texelFetch(u_own_0, texel, 0);
    for (int i = 0; i < 4; i++) {
        c[i] = part[i];
    }
#if ESTIMATES > 1
    part = texelFetch(u_own_1, texel, 0);
#endif
    for (int i = 0; i < 4; i++) {
        c[4 + i] = part[i];
    }
#if ESTIMATES > 2
    part = texelFetch(u_own_2, texel, 0);
#endif
    for (int i = 0; i < 4; i++) {
        c[8 + i] = part[i];
    }
}
