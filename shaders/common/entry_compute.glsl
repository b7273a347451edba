// Entry of a compute pass: one invocation per texel of the rows [u_first_row, u_last_row).

void main()
{
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy) + ivec2(0, u_first_row);
    if (texel.x >= u_columns || texel.y >= u_last_row) {
        return;
    }
    if (!texel_kernel(texel)) {
        return;
    }
#ifdef OUTPUT_0
    imageStore(u_image_0, texel, vec4(OUTPUT_0));
#endif
#ifdef OUTPUT_1
    imageStore(u_image_1, texel, vec4(OUTPUT_1));
#endif
#ifdef OUTPUT_2
    imageStore(u_image_2, texel, vec4(OUTPUT_2));
#endif
#ifdef OUTPUT_3
    imageStore(u_image_3, texel, vec4(OUTPUT_3));
#endif
#ifdef OUTPUT_4
    imageStore(u_image_4, texel, vec4(OUTPUT_4));
#endif
#ifdef OUTPUT_5
    imageStore(u_image_5, texel, vec4(OUTPUT_5));
#endif
}
