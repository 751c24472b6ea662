/*
 * Eight numbers at a time: the primitives of correct.h, in two versions.
 *
 * Vector types of GCC and Clang carry the arithmetic; only what they have no operator for is here.
 */
#undef LANES
#undef STAGE
#undef LANES_ENTRY
#undef NAME
#if WIDE
#define LANES static inline __attribute__((always_inline, target("avx2,fma")))
#define STAGE static __attribute__((noinline, target("avx2,fma")))
#define LANES_ENTRY static __attribute__((target("avx2,fma")))
#define NAME(name) name##_wide
#else
#define LANES static inline __attribute__((always_inline))
#define STAGE static __attribute__((noinline))
#define LANES_ENTRY static
#define NAME(name) name##_portable
#endif

LANES floats_t NAME(load)(const float *values) {
    floats_t result;
    memcpy(&result, values, sizeof result);
    return result;
}

LANES floats_t NAME(all)(float value) {
    return (floats_t){value, value, value, value, value, value, value, value};
}

LANES floats_t NAME(real)(ints_t values) { return __builtin_convertvector(values, floats_t); }

LANES ints_t NAME(whole)(floats_t values) { return __builtin_convertvector(values, ints_t); }

LANES floats_t NAME(size)(floats_t values) {
    return (floats_t)((ints_t)values & 0x7fffffff);
}

/* Both take the second of the two where the first is nan. */
LANES floats_t NAME(least)(floats_t values, floats_t most) {
#if WIDE
    return (floats_t)_mm256_min_ps((__m256)values, (__m256)most);
#else
    ints_t below = values < most;
    return (floats_t)(((ints_t)values & below) | ((ints_t)most & ~below));
#endif
}

LANES floats_t NAME(largest)(floats_t values, floats_t fewest) {
#if WIDE
    return (floats_t)_mm256_max_ps((__m256)values, (__m256)fewest);
#else
    ints_t above = values > fewest;
    return (floats_t)(((ints_t)values & above) | ((ints_t)fewest & ~above));
#endif
}

LANES floats_t NAME(root)(floats_t values) {
#if WIDE
    return (floats_t)_mm256_sqrt_ps((__m256)values);
#else
    for (int k = 0; k < 8; ++k) values[k] = sqrtf(values[k]);
    return values;
#endif
}

LANES floats_t NAME(pick)(floats_t values, ints_t which) {
#if WIDE
    return (floats_t)_mm256_permutevar8x32_ps((__m256)values, (__m256i)which);
#else
    floats_t result;
    for (int k = 0; k < 8; ++k) result[k] = values[which[k]];
    return result;
#endif
}

LANES floats_t NAME(either)(ints_t condition, floats_t yes, floats_t no) {
#if WIDE
    return (floats_t)_mm256_blendv_ps((__m256)no, (__m256)yes, (__m256)condition);
#else
    return (floats_t)(((ints_t)yes & condition) | ((ints_t)no & ~condition));
#endif
}

/* One by one also where there is an instruction: it is slower. */
LANES floats_t NAME(lookup)(const float *table, ints_t at) {
    return (floats_t){table[at[0]], table[at[1]], table[at[2]], table[at[3]],
                      table[at[4]], table[at[5]], table[at[6]], table[at[7]]};
}

/* Straight lines between the entries; the entry after the last one read must exist. */
LANES floats_t NAME(lookup_between)(const float *table, floats_t at) {
    ints_t floor = NAME(whole)(at);
    floats_t low = NAME(lookup)(table, floor), high = NAME(lookup)(table + 1, floor);
    return low + (at - NAME(real)(floor)) * (high - low);
}

/* A third of the exponent is within 4 % of the cube root; Halley's step cubes that error. */
LANES floats_t NAME(cube_root)(floats_t values) {
    values = NAME(largest)(values, NAME(all)(1e-30f));
    ints_t bits = NAME(whole)(NAME(real)((ints_t)values) * NAME(all)(1.0f / 3)) + 709921077;
    floats_t root = (floats_t)bits;
    for (int pass = 0; pass < 2; ++pass) {
        floats_t cubed = root * root * root;
        root = root * (cubed + values + values) / (cubed + cubed + values);
    }
    return root;
}

/* Eight bytes as numbers. */
LANES floats_t NAME(bytes)(const uint8_t *data) {
#if WIDE
    return real_wide((ints_t)_mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i *)data)));
#else
    floats_t values;
    for (int k = 0; k < 8; ++k) values[k] = data[k];
    return values;
#endif
}

/* Eight numbers, rounded and limited to bytes. */
LANES void NAME(store_bytes)(floats_t values, uint8_t *out) {
#if WIDE
    __m256i codes = _mm256_cvtps_epi32((__m256)values);
    __m128i words = _mm_packs_epi32(_mm256_castsi256_si128(codes),
                                    _mm256_extracti128_si256(codes, 1));
    _mm_storel_epi64((__m128i *)out, _mm_packus_epi16(words, words));
#else
    values = NAME(least)(NAME(largest)(values, NAME(all)(0)), NAME(all)(255));
    for (int k = 0; k < 8; ++k) out[k] = (uint8_t)(values[k] + 0.5f);
#endif
}

/* Sums of neighbours, those of `first` before those of `second`. */
LANES floats_t NAME(pair_sums)(floats_t first, floats_t second) {
#if WIDE
    __m256d sums = (__m256d)_mm256_hadd_ps((__m256)first, (__m256)second);
    return (floats_t)_mm256_permute4x64_pd(sums, 0xd8);
#else
    return (floats_t){first[0] + first[1], first[2] + first[3], first[4] + first[5],
                      first[6] + first[7], second[0] + second[1], second[2] + second[3],
                      second[4] + second[5], second[6] + second[7]};
#endif
}

/* Eight packed pixels. */
LANES void NAME(take8)(const uint8_t *data, floats_t values[3]) {
#if WIDE
    /* pixels 0-3 from bytes 0-11, 4-7 from bytes 12-23 of the 24 */
    __m256i bytes = _mm256_set_m128i(_mm_loadu_si128((const __m128i *)(data + 8)),
                                     _mm_loadu_si128((const __m128i *)data));
    const char n = -1;
    for (int c = 0; c < 3; ++c) {
        char a = (char)c;
        __m256i which = _mm256_setr_epi8(
            a, n, n, n, a + 3, n, n, n, a + 6, n, n, n, a + 9, n, n, n,
            a + 4, n, n, n, a + 7, n, n, n, a + 10, n, n, n, a + 13, n, n, n);
        values[c] = real_wide((ints_t)_mm256_shuffle_epi8(bytes, which));
    }
#else
    for (int k = 0; k < 24; ++k) values[k % 3][k / 3] = data[k];
#endif
}

/* The same back; values must lie in 0..255. */
LANES void NAME(store8)(const floats_t values[3], uint8_t *out) {
#if WIDE
    ints_t codes[3];
    for (int c = 0; c < 3; ++c) codes[c] = (ints_t)_mm256_cvtps_epi32((__m256)values[c]);
    __m256i packed = (__m256i)(codes[0] | (codes[1] << 8) | (codes[2] << 16));
    __m256i bytes = _mm256_shuffle_epi8(
        packed, _mm256_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1, 0, 1, 2, 4,
                                 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1));
    bytes = _mm256_permutevar8x32_epi32(bytes, _mm256_setr_epi32(0, 1, 2, 4, 5, 6, 7, 7));
    _mm_storeu_si128((__m128i *)out, _mm256_castsi256_si128(bytes));
    _mm_storel_epi64((__m128i *)(out + 16), _mm256_extracti128_si256(bytes, 1));
#else
    for (int k = 0; k < 24; ++k) out[k] = (uint8_t)(values[k % 3][k / 3] + 0.5f);
#endif
}

#if WIDE
/* Whether offsets into the picture fit 32 bits. */
LANES int can_sample_wide(const plan_t *plan, picture_t source) {
    ptrdiff_t stride = source.stride < 0 ? -source.stride : source.stride;
    return plan->n_channels == 3 && plan->in_type != FLOAT32 &&
           stride < INT32_MAX / (plan->in_height + 1);
}

/* Weights of two neighbours in a row, 14 bits each: (left, right) in one 32-bit lane. */
LANES ints_t weights_wide(floats_t share) {
    ints_t right = (ints_t)_mm256_cvtps_epi32((__m256)(share * all_wide(16384)));
    return (right << 16) + (16384 - right);
}

LANES floats_t blended_wide(__m256i pair, ints_t weights) {
    return real_wide((ints_t)_mm256_madd_epi16(pair, (__m256i)weights));
}

LANES __m256i bytes_to_words_wide(__m256i values, char low, char high) {
    const char n = -1; /* zero */
    __m256i which = _mm256_setr_epi8(
        low, n, high, n, low + 4, n, high + 4, n, low + 8, n, high + 8, n, low + 12, n, high + 12, n,
        low, n, high, n, low + 4, n, high + 4, n, low + 8, n, high + 8, n, low + 12, n, high + 12, n);
    return _mm256_shuffle_epi8(values, which);
}

/* Whether 16 bytes from each of eight pixels lie in the picture, in this row and the next. */
LANES int is_inside_wide(const plan_t *plan, floats_t x, floats_t y) {
    ints_t inside = (x >= 0) & (y >= 0) & (x < (float)(plan->in_width - 5)) &
                    (y < (float)(plan->in_height - 1));
    return _mm256_movemask_ps((__m256)inside) == 0xff;
}

/* Whether that is so wherever some nodes lead: what lies between two of them is inside with both. */
LANES int is_inside_all_wide(const plan_t *plan, const float nodes[2][NODES], int n_nodes) {
    for (int k = 0; k < n_nodes; k += 8) {
        floats_t x = load_wide(nodes[0] + k), y = load_wide(nodes[1] + k);
        if (!is_inside_wide(plan, x, y)) return 0;
    }
    return 1;
}

LANES __m256i gather64_wide(const uint8_t *data, const int32_t *at) {
    __m128 low = (__m128)_mm_loadl_epi64((const __m128i *)(data + at[0]));
    __m128 high = (__m128)_mm_loadl_epi64((const __m128i *)(data + at[4]));
    low = _mm_loadh_pi(low, (const __m64 *)(data + at[1]));
    high = _mm_loadh_pi(high, (const __m64 *)(data + at[5]));
    return (__m256i)_mm256_set_m128(high, low);
}

LANES void sample8_wide(picture_t source, floats_t x, floats_t y, floats_t values[3]) {
    ints_t left = whole_wide(x), top = whole_wide(y);
    ints_t weights = weights_wide(x - real_wide(left));
    floats_t low_share = y - real_wide(top), rows[2][3];
    int32_t at[8];
    _mm256_storeu_si256((__m256i *)at, (__m256i)(top * (int)source.stride + left * 3));
    for (int row = 0; row < 2; ++row) {
        const uint8_t *data = source.data + row * source.stride;
        /* R G B r | g b . . of each pixel and its right neighbour; pixels 0 1 4 5 and 2 3 6 7 */
        __m256 a = (__m256)gather64_wide(data, at), b = (__m256)gather64_wide(data, at + 2);
        __m256i first = (__m256i)_mm256_shuffle_ps(a, b, 0x88);
        __m256i second = (__m256i)_mm256_shuffle_ps(a, b, 0xdd);
        /* R G g b */
        __m256i middle = _mm256_blend_epi16(first, _mm256_slli_epi32(second, 16), 0xaa);
        rows[row][0] = blended_wide(bytes_to_words_wide(first, 0, 3), weights);
        rows[row][1] = blended_wide(bytes_to_words_wide(middle, 1, 2), weights);
        /* B r g b */
        __m256i last = _mm256_blend_epi16(_mm256_srli_epi32(first, 16), middle, 0xaa);
        rows[row][2] = blended_wide(bytes_to_words_wide(last, 0, 3), weights);
    }
    floats_t low = low_share * all_wide(1.0f / 16384), high = all_wide(1.0f / 16384) - low;
    for (int c = 0; c < 3; ++c) values[c] = rows[0][c] * high + rows[1][c] * low;
}

/* 16 bytes from each of pixels k and k + 4. */
LANES __m256i gather128_wide(const uint8_t *data, const int32_t *at) {
    return _mm256_set_m128i(_mm_loadu_si128((const __m128i *)(data + at[4])),
                            _mm_loadu_si128((const __m128i *)(data + at[0])));
}

LANES void sample16_wide(picture_t source, floats_t x, floats_t y, floats_t values[3]) {
    ints_t left = whole_wide(x), top = whole_wide(y);
    ints_t weights = weights_wide(x - real_wide(left));
    ints_t swapped = (ints_t)_mm256_or_si256(_mm256_slli_epi32((__m256i)weights, 16),
                                             _mm256_srli_epi32((__m256i)weights, 16));
    floats_t low_share = y - real_wide(top), rows[2][3];
    int32_t at[8];
    _mm256_storeu_si256((__m256i *)at, (__m256i)(top * (int)source.stride + left * 6));
    /* the products are of signed numbers: 32768 is taken off, and put back at the end */
    __m256i half = _mm256_set1_epi16(-32768);
    for (int row = 0; row < 2; ++row) {
        const uint8_t *data = source.data + row * source.stride;
        /* R G | B r | g b | . . of each pixel and its right neighbour, then four pixels side by side
         */
        __m256i a = gather128_wide(data, at), b = gather128_wide(data, at + 1);
        __m256i c = gather128_wide(data, at + 2), d = gather128_wide(data, at + 3);
        __m256i ab = _mm256_unpacklo_epi32(a, b), cd = _mm256_unpacklo_epi32(c, d);
        __m256i first = _mm256_xor_si256(_mm256_unpacklo_epi64(ab, cd), half);
        __m256i second = _mm256_xor_si256(_mm256_unpackhi_epi64(ab, cd), half);
        __m256i third = _mm256_xor_si256(
            _mm256_unpacklo_epi64(_mm256_unpackhi_epi32(a, b), _mm256_unpackhi_epi32(c, d)), half);
        rows[row][0] = blended_wide(_mm256_blend_epi16(first, second, 0xaa), weights);
        rows[row][1] = blended_wide(_mm256_blend_epi16(third, first, 0xaa), swapped);
        rows[row][2] = blended_wide(_mm256_blend_epi16(second, third, 0xaa), weights);
    }
    floats_t low = low_share * all_wide(1.0f / 16384), high = all_wide(1.0f / 16384) - low;
    for (int c = 0; c < 3; ++c) {
        values[c] = rows[0][c] * high + (rows[1][c] * low + all_wide(32768));
    }
}

LANES void store16_wide(const floats_t values[3], uint8_t *out) {
    __m256i codes[3];
    for (int c = 0; c < 3; ++c) codes[c] = _mm256_cvtps_epi32((__m256)values[c]);
    __m256i pair = _mm256_or_si256(codes[0], _mm256_slli_epi32(codes[1], 16));
    for (int half = 0; half < 2; ++half) {
        __m128i ab = half ? _mm256_extracti128_si256(pair, 1) : _mm256_castsi256_si128(pair);
        __m128i c = half ? _mm256_extracti128_si256(codes[2], 1) : _mm256_castsi256_si128(codes[2]);
        const char n = -1;
        __m128i low = _mm_or_si128(
            _mm_shuffle_epi8(ab, _mm_setr_epi8(0, 1, 2, 3, n, n, 4, 5, 6, 7, n, n, 8, 9, 10, 11)),
            _mm_shuffle_epi8(c, _mm_setr_epi8(n, n, n, n, 0, 1, n, n, n, n, 4, 5, n, n, n, n)));
        __m128i high = _mm_or_si128(
            _mm_shuffle_epi8(
                ab, _mm_setr_epi8(n, n, 12, 13, 14, 15, n, n, n, n, n, n, n, n, n, n)),
            _mm_shuffle_epi8(c, _mm_setr_epi8(8, 9, n, n, n, n, 12, 13, n, n, n, n, n, n, n, n)));
        _mm_storeu_si128((__m128i *)(out + 24 * half), low);
        _mm_storel_epi64((__m128i *)(out + 24 * half + 16), high);
    }
}
#endif
