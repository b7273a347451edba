// Entry of a fragment pass: one fragment per texel. The outputs are attachments of the frame buffer.

void main()
{
    if (!texel_kernel(ivec2(gl_FragCoord.xy))) {
        discard;
    }
}
