// Entry of a fragment pass: one fragment a texel; the outputs are the frame buffer's attachments.

void main()
{
    if (!texel_kernel(ivec2(gl_FragCoord.xy))) {
        discard;
    }
}
