// What was measured of a texel: u_measure, numbers that are negative where none has been measured yet.

float measure_at(ivec2 texel, int number)
{
    float measured[12];
    read_measure(texel, measured);
    return measured[number];
}
