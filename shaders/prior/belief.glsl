// What is believed of a texel's numbers: u_mean_0 … and u_deviation_0 …, packed as the estimates are; a deviation of 0
// says nothing.

void means_at(ivec2 texel, out float c[12])
{
    vec4 part = texelFetch(u_mean_0, texel, 0);
    for (int i = 0; i < 4; i++) {
        c[i] = part[i];
    }
#if ESTIMATES > 1
    part = texelFetch(u_mean_1, texel, 0);
#endif
    for (int i = 0; i < 4; i++) {
        c[4 + i] = part[i];
    }
#if ESTIMATES > 2
    part = texelFetch(u_mean_2, texel, 0);
#endif
    for (int i = 0; i < 4; i++) {
        c[8 + i] = part[i];
    }
}

void deviations_at(ivec2 texel, out float c[12])
{
    vec4 part = texelFetch(u_deviation_0, texel, 0);
    for (int i = 0; i < 4; i++) {
        c[i] = part[i];
    }
#if ESTIMATES > 1
    part = texelFetch(u_deviation_1, texel, 0);
#endif
    for (int i = 0; i < 4; i++) {
        c[4 + i] = part[i];
    }
#if ESTIMATES > 2
    part = texelFetch(u_deviation_2, texel, 0);
#endif
    for (int i = 0; i < 4; i++) {
        c[8 + i] = part[i];
    }
}
