/*
 * Frames of 8-bit YUV whose chroma planes have half the size (4:2:0), to packed RGB and back.
 *
 * Chroma lies in the middle of the four pixels that it belongs to: it is interpolated between its
 * samples, and is that of the pixels' mean. Nothing is rounded in between. Included twice, as
 * correct.h is.
 */

/* One of the chroma planes at a row of pixels, from sample `first` - 1 on; the border goes on. */
STAGE void NAME(chroma_of_row)(const yuv_t *frame, picture_t plane, ptrdiff_t y, ptrdiff_t first,
                               ptrdiff_t n_samples, float *out) {
    const ptrdiff_t width = (frame->width + 1) / 2, height = (frame->height + 1) / 2;
    ptrdiff_t near = y / 2, far = near + (y % 2 ? 1 : -1);
    far = far < 0 ? 0 : far >= height ? height - 1 : far;
    const uint8_t *near_row = plane.data + near * plane.stride;
    const uint8_t *far_row = plane.data + far * plane.stride;
    ptrdiff_t start = first == 0, end = width - first + 1;
    if (end > n_samples) end = n_samples;
    for (ptrdiff_t k = start; k < end; ++k) {
        out[k] = 0.75f * near_row[first - 1 + k] + 0.25f * far_row[first - 1 + k];
    }
    if (start) out[0] = out[1];
    for (ptrdiff_t k = end; k < n_samples; ++k) out[k] = out[end - 1];
}

/* A matrix row of three columns and a constant. */
LANES floats_t NAME(combined)(const float row[4], const floats_t in[3]) {
    return NAME(all)(row[0]) * in[0] + NAME(all)(row[1]) * in[1] + NAME(all)(row[2]) * in[2] +
           NAME(all)(row[3]);
}

LANES_ENTRY void NAME(rgb_rows)(const yuv_t *frame) {
    enum { N_SAMPLES = SEGMENT / 2 + 8 };
    const ints_t near = {1, 1, 2, 2, 3, 3, 4, 4}, far = {0, 2, 1, 3, 2, 4, 3, 5};
    const floats_t most = NAME(all)(0.75f), rest = NAME(all)(0.25f);
    const yuv_t own = *frame; /* what is stored cannot change it */
    float chroma[2][N_SAMPLES];
    for (ptrdiff_t y = 0; y < own.height; ++y) {
        const uint8_t *luma = own.luma.data + y * own.luma.stride;
        uint8_t *out = (uint8_t *)own.rgb.data + y * own.rgb.stride;
        for (ptrdiff_t start = 0; start < own.width; start += SEGMENT) {
            ptrdiff_t left = own.width - start;
            int n_pixels = left < SEGMENT ? (int)left : SEGMENT;
            for (int c = 0; c < 2; ++c) {
                NAME(chroma_of_row)(&own, own.chroma[c], y, start / 2, (n_pixels + 1) / 2 + 8,
                                    chroma[c]);
            }
            for (int k = 0; k < n_pixels; k += 8) {
                uint8_t codes[8] = {0}, pixels[24];
                int is_whole = k + 8 <= n_pixels, count = is_whole ? 8 : n_pixels - k;
                if (!is_whole) memcpy(codes, luma + start + k, (size_t)count);
                floats_t in[3], rgb[3];
                in[0] = NAME(bytes)(is_whole ? luma + start + k : codes);
                for (int c = 0; c < 2; ++c) {
                    floats_t samples = NAME(load)(chroma[c] + k / 2);
                    in[1 + c] = most * NAME(pick)(samples, near) + rest * NAME(pick)(samples, far);
                }
                for (int c = 0; c < 3; ++c) {
                    rgb[c] = NAME(largest)(NAME(combined)(own.matrix[c], in), NAME(all)(0));
                    rgb[c] = NAME(least)(rgb[c], NAME(all)(255));
                }
                NAME(store8)(rgb, is_whole ? out + 3 * (start + k) : pixels);
                if (!is_whole) memcpy(out + 3 * (start + k), pixels, 3 * (size_t)count);
            }
        }
    }
}

/* Two rows of sixteen pixels: their luma, and eight samples of each chroma plane. */
LANES void NAME(yuv_block)(const float matrix[3][4], const uint8_t *const rgb[2], uint8_t *luma[2],
                           uint8_t *chroma[2]) {
    floats_t sums[2][3];
    for (int half = 0; half < 2; ++half) {
        floats_t rows[2][3];
        for (int row = 0; row < 2; ++row) {
            NAME(take8)(rgb[row] + 24 * half, rows[row]);
            NAME(store_bytes)(NAME(combined)(matrix[0], rows[row]), luma[row] + 8 * half);
        }
        for (int c = 0; c < 3; ++c) {
            sums[half][c] = (rows[0][c] + rows[1][c]) * NAME(all)(0.25f);
        }
    }
    floats_t means[3];
    for (int c = 0; c < 3; ++c) means[c] = NAME(pair_sums)(sums[0][c], sums[1][c]);
    for (int c = 0; c < 2; ++c) {
        NAME(store_bytes)(NAME(combined)(matrix[1 + c], means), chroma[c]);
    }
}

LANES_ENTRY void NAME(yuv_rows)(const yuv_t *frame) {
    const yuv_t own = *frame;
    for (ptrdiff_t y = 0; y < own.height; y += 2) {
        const uint8_t *rgb[2];
        uint8_t *luma[2], *chroma[2];
        for (int k = 0; k < 2; ++k) {
            rgb[k] = own.rgb.data + (y + k) * own.rgb.stride;
            luma[k] = (uint8_t *)own.luma.data + (y + k) * own.luma.stride;
            chroma[k] = (uint8_t *)own.chroma[k].data + y / 2 * own.chroma[k].stride;
        }
        ptrdiff_t x = 0;
        for (; x + 16 <= own.width; x += 16) {
            const uint8_t *from[2] = {rgb[0] + 3 * x, rgb[1] + 3 * x};
            NAME(yuv_block)(own.matrix, from, (uint8_t *[2]){luma[0] + x, luma[1] + x},
                            (uint8_t *[2]){chroma[0] + x / 2, chroma[1] + x / 2});
        }
        if (x < own.width) { /* what is left, by way of blocks of its own */
            uint8_t pixels[2][48] = {{0}}, codes[2][16], samples[2][8];
            size_t count = (size_t)(own.width - x);
            for (int k = 0; k < 2; ++k) memcpy(pixels[k], rgb[k] + 3 * x, 3 * count);
            const uint8_t *from[2] = {pixels[0], pixels[1]};
            NAME(yuv_block)(own.matrix, from, (uint8_t *[2]){codes[0], codes[1]},
                            (uint8_t *[2]){samples[0], samples[1]});
            for (int k = 0; k < 2; ++k) {
                memcpy(luma[k] + x, codes[k], count);
                memcpy(chroma[k] + x / 2, samples[k], count / 2);
            }
        }
    }
}
