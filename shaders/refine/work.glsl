// The material that is worked on: u_work_0 …, packed as the estimates are.

void work_at(ivec2 texel, out float c[12])
{
    for (int i = 0; i < 12; i++) {
        c[i] = 0.0;
    }
    vec4 part = texelFetch(u_work_0, texel, 0);
    for (int i = 0; i < 4; i++) {
        c[i] = part[i];
    }
#if ESTIMATES > 1
    part = texelFetch(u_work_1, texel, 0);
    for (int i = 0; i < 4; i++) {
        c[4 + i] = part[i];
    }
#endif
#if ESTIMATES > 2
    part = texelFetch(u_work_2, texel, 0);
    for (int i = 0; i < 4; i++) {
        c[8 + i] = part[i];
    }
#endif
}
