// Outputs of a compute pass: plain variables in place of the fragment outputs. The entry stores them after the kernel
// has run. The pass defines OUTPUT_n and OUTPUT_n_TYPE, in the order of its outputs.

#ifdef OUTPUT_0
OUTPUT_0_TYPE OUTPUT_0;
#endif
#ifdef OUTPUT_1
OUTPUT_1_TYPE OUTPUT_1;
#endif
#ifdef OUTPUT_2
OUTPUT_2_TYPE OUTPUT_2;
#endif
#ifdef OUTPUT_3
OUTPUT_3_TYPE OUTPUT_3;
#endif
#ifdef OUTPUT_4
OUTPUT_4_TYPE OUTPUT_4;
#endif
#ifdef OUTPUT_5
OUTPUT_5_TYPE OUTPUT_5;
#endif
