// What was measured of a texel: u_measure_0 …, packed numbers, negative where none has been measured yet.

#if MEASURES > 0
float measure_at(ivec2 texel, int number)
{
    vec4 four = texelFetch(u_measure_0, texel, 0);
#if MEASURES > 1
    four = number >= 4 ? texelFetch(u_measure_1, texel, 0) : four;
#endif
#if MEASURES > 2
    four = number >= 8 ? texelFetch(u_measure_2, texel, 0) : four;
#endif
    return four[number % 4];
}
#endif
