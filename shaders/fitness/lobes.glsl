// Interchangeable lobes stay in rising order.
void order_lobes(inout float c[12])
{
#ifdef LOBE_FIRST
    if (c[LOBE_FIRST] > c[LOBE_SECOND]) {
        float kept = c[LOBE_FIRST];
        c[LOBE_FIRST] = c[LOBE_SECOND];
        c[LOBE_SECOND] = kept;
#ifdef LOBE_WEIGHT
        c[LOBE_WEIGHT] = 1.0 - c[LOBE_WEIGHT];
#endif
    }
#endif
}
