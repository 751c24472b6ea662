/*
 * Rows of a picture corrected, eight pixels at a time, in steps over a piece of a
 * row that stays in the fastest cache:
 * where from -> bilinear sample -> linear light -> gain -> colour -> transfer function -> store.
 *
 * Included twice: with WIDE 1 every function is compiled for AVX2 and FMA and the primitives are
 * intrinsics, with WIDE 0 for whatever the compiler targets.
 */

/* Nodes at one row of output pixels, so that only the horizontal half is left per pixel. */
STAGE void NAME(nodes_of_row)(const grid_t *grid, ptrdiff_t y, ptrdiff_t x, ptrdiff_t n_pixels,
                              float nodes[][NODES]) {
    ptrdiff_t row = y / grid->step, first = x / grid->step;
    ptrdiff_t below = row + 1 < grid->height ? grid->pitch : 0;
    float share = (float)(y % grid->step) / (float)grid->step;
    ptrdiff_t n_nodes = (n_pixels + 7) / grid->step + 9;
    for (int plane = 0; plane < grid->n_planes; ++plane) {
        const float *above = grid->nodes + (plane * grid->height + row) * grid->pitch + first;
        for (ptrdiff_t k = 0; k < n_nodes; ++k) {
            nodes[plane][k] = above[k] + share * (above[below + k] - above[k]);
        }
    }
}

LANES between_t NAME(between)(int step) {
    between_t between;
    for (int k = 0; k < 8; ++k) {
        between.left[k] = k / step;
        between.share[k] = (float)(k % step) / (float)step;
    }
    return between;
}

LANES floats_t NAME(expand)(const float *nodes, int step, const between_t *between) {
    floats_t left, right;
    if (step == 8) {
        left = NAME(all)(nodes[0]);
        right = NAME(all)(nodes[1]);
    } else {
        left = NAME(pick)(NAME(load)(nodes), between->left);
        right = NAME(pick)(NAME(load)(nodes + 1), between->left);
    }
    return left + between->share * (right - left);
}

/* One sample; what lies outside the picture is black. */
LANES float NAME(stored)(const plan_t *plan, picture_t source, ptrdiff_t x, ptrdiff_t y,
                         int channel) {
    if (x < 0 || y < 0 || x >= plan->in_width || y >= plan->in_height) return 0;
    const uint8_t *row = source.data + y * source.stride;
    ptrdiff_t at = x * plan->n_channels + channel;
    switch (plan->in_type) {
    case UINT8: return row[at];
    case UINT16: return ((const uint16_t *)row)[at];
    default: return ((const float *)row)[at];
    }
}

LANES void NAME(sample_anywhere)(const plan_t *plan, picture_t source, floats_t x, floats_t y,
                                 floats_t values[3]) {
    for (int k = 0; k < 8; ++k) {
        for (int channel = 0; channel < plan->n_channels; ++channel) values[channel][k] = 0;
        /* false for nan as well */
        if (!(x[k] > -1 && y[k] > -1 && x[k] < plan->in_width && y[k] < plan->in_height)) continue;
        ptrdiff_t left = (ptrdiff_t)(x[k] + 1) - 1, top = (ptrdiff_t)(y[k] + 1) - 1;
        if ((float)left > x[k]) --left; /* -1e-9 + 1 rounds to 1 */
        if ((float)top > y[k]) --top;
        float right_share = x[k] - (float)left, low_share = y[k] - (float)top;
        for (int channel = 0; channel < plan->n_channels; ++channel) {
            float corners[2][2];
            for (int j = 0; j < 4; ++j) {
                corners[j / 2][j % 2] =
                    NAME(stored)(plan, source, left + j % 2, top + j / 2, channel);
            }
            float upper = corners[0][0] + right_share * (corners[0][1] - corners[0][0]);
            float lower = corners[1][0] + right_share * (corners[1][1] - corners[1][0]);
            values[channel][k] = upper + low_share * (lower - upper);
        }
    }
}

STAGE void NAME(take)(const plan_t *plan, picture_t source, ptrdiff_t x, ptrdiff_t y, int n_pixels,
                      planes_t planes) {
    int k = 0;
#if WIDE
    if (plan->in_type == UINT8 && plan->n_channels == 3) {
        const uint8_t *data = source.data + y * source.stride + 3 * x;
        for (; k < n_pixels / 8; ++k) {
            floats_t values[3];
            take8_wide(data + 24 * k, values);
            for (int c = 0; c < 3; ++c) planes[c][k] = values[c];
        }
    }
#endif
    /* the last block is filled up: its lanes become indices as all others do */
    for (int c = 0; c < plan->n_channels; ++c) {
        for (int at = 8 * k; at < (n_pixels + 7) / 8 * 8; ++at) {
            float value = at < n_pixels ? NAME(stored)(plan, source, x + at, y, c) : 0;
            planes[c][at / 8][at % 8] = value;
        }
    }
}

/* A curve whose polynomial takes `at`, and whose foot takes `value`. */
LANES floats_t NAME(on_curve)(const curve_t *curve, floats_t at, floats_t value) {
    floats_t result = NAME(all)(curve->powers[N_POWERS - 1]);
    for (int power = N_POWERS - 2; power >= 0; --power) {
        result = result * at + NAME(all)(curve->powers[power]);
    }
    ints_t is_foot = value < NAME(all)(curve->foot_end);
    return NAME(either)(is_foot, value * NAME(all)(curve->foot_slope), result);
}

/* Stored numbers of one channel to linear light that has been made up for the fall-off. */
STAGE void NAME(light)(const plan_t *plan, int c, const float *nodes, floats_t *plane,
                       int n_blocks) {
    const int linearisation = plan->linearisation, step = plan->gain.step;
    const int is_byte = plan->in_type == UINT8, is_float = plan->in_type == FLOAT32;
    const floats_t none = NAME(all)(0), one = NAME(all)(1);
    const floats_t top = NAME(all)((float)(plan->n_linear - 1));
    const floats_t scale = NAME(all)(1 / plan->full_scale), balance = NAME(all)(plan->balance[c]);
    const float *table = plan->linear + c * (plan->n_linear + 1);
    const curve_t curve = plan->curve;
    const int limits = !is_byte || plan->full_scale < 255;
    const between_t between = NAME(between)(step ? step : 1);
    for (int k = 0; k < n_blocks; ++k) {
        floats_t value = plane[k] * scale;
        if (limits && (linearisation != LINEAR || !is_float)) {
            value = NAME(least)(NAME(largest)(value, none), one);
        }
        if (linearisation == BY_CURVE) {
            value = NAME(on_curve)(&curve, value, value);
        } else if (linearisation == BY_TABLE) {
            value = NAME(lookup_between)(table, value * top);
        }
        plane[k] = value * (step ? NAME(expand)(nodes + 8 * k / step, step, &between) : balance);
    }
}

/* Tetrahedral interpolation; the table is indexed by the root of balanced light. */
LANES void NAME(add_table)(const plan_t *plan, const floats_t balanced[3], floats_t out[3]) {
    int size = plan->table_size;
    float top = (float)(size - 1);
    int strides[3] = {size * size * 4, size * 4, 4};
    floats_t share[3];
    ints_t corner = NAME(whole)(NAME(all)(0));
    for (int c = 0; c < 3; ++c) {
        floats_t at = NAME(largest)(balanced[c] * NAME(all)(plan->table_scale[c]), NAME(all)(0));
        at = NAME(root)(NAME(least)(at, NAME(all)(1))) * NAME(all)(top);
        floats_t floor = NAME(real)(NAME(whole)(NAME(least)(at, NAME(all)(top - 1))));
        share[c] = at - floor;
        corner += NAME(whole)(floor) * strides[c];
    }
    for (int k = 0; k < 8; ++k) {
        float shares[3] = {share[0][k], share[1][k], share[2][k]};
        int steps[3] = {strides[0], strides[1], strides[2]};
        for (int pass = 0; pass < 3; ++pass) { /* the largest share first */
            int a = pass % 2, b = a + 1;
            if (shares[a] < shares[b]) {
                float held = shares[a];
                int held_step = steps[a];
                shares[a] = shares[b], steps[a] = steps[b];
                shares[b] = held, steps[b] = held_step;
            }
        }
        const float *node = plan->table + corner[k];
        float weight = 1 - shares[0], sum[4];
        for (int j = 0; j < 4; ++j) sum[j] = weight * node[j];
        for (int pass = 0; pass < 3; ++pass) {
            node += steps[pass];
            weight = pass < 2 ? shares[pass] - shares[pass + 1] : shares[pass];
            for (int j = 0; j < 4; ++j) sum[j] += weight * node[j];
        }
        for (int c = 0; c < 3; ++c) out[c][k] += sum[c];
    }
}

LANES void NAME(add_matrix)(const float matrix[9], const floats_t in[3], floats_t out[3]) {
    for (int c = 0; c < 3; ++c) {
        out[c] += NAME(all)(matrix[3 * c]) * in[0] + NAME(all)(matrix[3 * c + 1]) * in[1] +
                  NAME(all)(matrix[3 * c + 2]) * in[2];
    }
}

/* factors: 0 one, 1-3 balanced, 4-6 roots, 7-9 cube roots of the lifted channels,
 * 10 radius about the grey axis, 11-14 cos, sin of twice and of three times the hue */
LANES void NAME(lift)(const floats_t rgb[3], floats_t floor_share, floats_t lifted[3]) {
    floats_t sizes = NAME(size)(rgb[0]) + NAME(size)(rgb[1]) + NAME(size)(rgb[2]);
    floats_t floor = sizes * floor_share;
    for (int c = 0; c < 3; ++c) lifted[c] = rgb[c] + NAME(root)(rgb[c] * rgb[c] + floor * floor);
}

/* Root-polynomials of degree 2, which most cameras get. */
STAGE void NAME(colour_by_pairs)(const plan_t *plan, planes_t planes, int n_blocks) {
    const plan_t own = *plan; /* what is stored in planes cannot change it */
    const floats_t floor_share = NAME(all)(2 * plan->lift / 3);
    for (int k = 0; k < n_blocks; ++k) {
        const floats_t rgb[3] = {planes[0][k], planes[1][k], planes[2][k]};
        floats_t out[3], roots[3], pairs[3];
        for (int c = 0; c < 3; ++c) out[c] = NAME(all)(own.offset[c]);
        NAME(add_matrix)(own.matrix, rgb, out);
        NAME(lift)(rgb, floor_share, roots);
        for (int c = 0; c < 3; ++c) roots[c] = NAME(root)(roots[c]);
        for (int c = 0; c < 3; ++c) {
            pairs[c] = roots[c] - roots[(c + 1) % 3];
            pairs[c] = pairs[c] * pairs[c];
        }
        NAME(add_matrix)(own.pair_matrix, pairs, out);
        for (int c = 0; c < 3; ++c) planes[c][k] = out[c];
    }
}

STAGE void NAME(colour)(const plan_t *plan, planes_t planes, int n_blocks) {
    const int features = plan->features, has_table = plan->table_size > 0;
    const int n_terms = plan->n_terms;
    const floats_t floor_share = NAME(all)(2 * plan->lift / 3);
    const floats_t lifted_scale = NAME(all)(0.5f / plan->lifted_grey);
    for (int k = 0; k < n_blocks; ++k) {
        const floats_t rgb[3] = {planes[0][k], planes[1][k], planes[2][k]};
        floats_t out[3], factors[N_FACTORS];
        for (int c = 0; c < 3; ++c) out[c] = NAME(all)(plan->offset[c]);
        NAME(add_matrix)(plan->matrix, rgb, out);
        if (features & FEATURE_ROOTS) {
            floats_t lifted[3];
            NAME(lift)(rgb, floor_share, lifted);
            for (int c = 0; c < 3; ++c) {
                lifted[c] = lifted[c] * lifted_scale;
                factors[4 + c] = NAME(root)(lifted[c]);
            }
            NAME(add_matrix)(plan->lifted_matrix, lifted, out);
            if (features & FEATURE_CUBE_ROOTS) {
                for (int c = 0; c < 3; ++c) factors[7 + c] = NAME(cube_root)(lifted[c]);
            }
        }
        if (features & FEATURE_HUE) {
            floats_t along = rgb[0] + rgb[0] - rgb[1] - rgb[2];
            floats_t across = (rgb[1] - rgb[2]) * NAME(all)(1.7320508f);
            floats_t squared = NAME(largest)(along * along + across * across, NAME(all)(1e-30f));
            factors[10] = NAME(root)(squared);
            floats_t inverse = NAME(all)(1) / factors[10];
            floats_t cosine = along * inverse, sine = across * inverse;
            factors[11] = cosine * cosine - sine * sine;
            factors[12] = NAME(all)(2) * cosine * sine;
            factors[13] = factors[11] * cosine - factors[12] * sine;
            factors[14] = factors[12] * cosine + factors[11] * sine;
        }
        if (n_terms) {
            factors[0] = NAME(all)(1);
            for (int c = 0; c < 3; ++c) factors[1 + c] = rgb[c];
            for (int term = 0; term < n_terms; ++term) {
                const uint8_t *own = plan->factors[term];
                floats_t value = factors[own[0]] * factors[own[1]] * factors[own[2]];
                for (int c = 0; c < 3; ++c) {
                    out[c] += NAME(all)(plan->coefficients[term][c]) * value;
                }
            }
        }
        if (has_table) NAME(add_table)(plan, rgb, out);
        for (int c = 0; c < 3; ++c) planes[c][k] = out[c];
    }
}

/* Linear channels of the output, or plain samples, to the numbers that are stored. */
STAGE void NAME(scale)(const plan_t *plan, floats_t *plane, int n_blocks) {
    const int clips = plan->clips, is_encoded = plan->is_encoded;
    const int rounds = plan->out_type != FLOAT32 && !clips;
    const floats_t none = NAME(all)(0), one = NAME(all)(1), scale = NAME(all)(plan->out_scale);
    const floats_t most = NAME(all)(plan->out_type == UINT8 ? 255 : 65535);
    const curve_t encoding = plan->encoding;
    for (int k = 0; k < n_blocks; ++k) {
        floats_t value = plane[k];
        if (clips) value = NAME(least)(NAME(largest)(value, none), one);
        if (is_encoded) {
            value = NAME(on_curve)(&encoding, NAME(root)(NAME(root)(value)), value);
        }
        value = value * scale;
        plane[k] = rounds ? NAME(least)(NAME(largest)(value, none), most) : value;
    }
}

STAGE void NAME(store)(const plan_t *plan, planes_t planes, uint8_t *out, int n_pixels) {
    int k = 0;
#if WIDE
    if (plan->n_channels == 3 && plan->out_type != FLOAT32) {
        for (; k < n_pixels / 8; ++k) {
            const floats_t values[3] = {planes[0][k], planes[1][k], planes[2][k]};
            if (plan->out_type == UINT8) {
                store8_wide(values, out + 24 * k);
            } else {
                store16_wide(values, out + 48 * k);
            }
        }
    }
#endif
    for (int c = 0; c < plan->n_channels; ++c) {
        for (int pixel = 8 * k; pixel < n_pixels; ++pixel) {
            ptrdiff_t at = (ptrdiff_t)pixel * plan->n_channels + c;
            float value = planes[c][pixel / 8][pixel % 8];
            switch (plan->out_type) {
            case UINT8: out[at] = (uint8_t)(value + 0.5f); break;
            case UINT16: ((uint16_t *)out)[at] = (uint16_t)(value + 0.5f); break;
            default: ((float *)out)[at] = value;
            }
        }
    }
}

STAGE void NAME(sample)(const plan_t *plan, picture_t source, const float nodes[2][NODES],
                        planes_t planes, int n_blocks) {
    const int step = plan->map.step;
    const between_t between = NAME(between)(step);
#if WIDE
    const int is_wide = can_sample_wide(plan, source);
    const int is_byte = plan->in_type == UINT8;
    if (is_wide && is_inside_all_wide(plan, nodes, n_blocks * 8 / step + 2)) {
        for (int k = 0; k < n_blocks; ++k) {
            floats_t values[3];
            floats_t x = NAME(expand)(nodes[0] + 8 * k / step, step, &between);
            floats_t y = NAME(expand)(nodes[1] + 8 * k / step, step, &between);
            if (is_byte) {
                sample8_wide(source, x, y, values);
            } else {
                sample16_wide(source, x, y, values);
            }
            for (int c = 0; c < 3; ++c) planes[c][k] = values[c];
        }
        return;
    }
#endif
    for (int k = 0; k < n_blocks; ++k) {
        floats_t values[3];
        floats_t x = NAME(expand)(nodes[0] + 8 * k / step, step, &between);
        floats_t y = NAME(expand)(nodes[1] + 8 * k / step, step, &between);
#if WIDE
        if (is_wide && is_inside_wide(plan, x, y)) {
            if (is_byte) {
                sample8_wide(source, x, y, values);
            } else {
                sample16_wide(source, x, y, values);
            }
        } else
#endif
            NAME(sample_anywhere)(plan, source, x, y, values);
        for (int c = 0; c < plan->n_channels; ++c) planes[c][k] = values[c];
    }
}

LANES_ENTRY void NAME(correct_rows)(const plan_t *plan, picture_t source, picture_t out,
                                    ptrdiff_t first, ptrdiff_t last) {
    float map[2][NODES], gain[3][NODES];
    floats_t buffers[3][SEGMENT / 8];
    const ptrdiff_t pixel = (ptrdiff_t)plan->n_channels * plan->out_type;
    const int red = plan->is_bgr ? 2 : 0;
    planes_t stored = {buffers[0], buffers[1], buffers[2]};
    planes_t rgb = {buffers[red], buffers[1], buffers[2 - red]};
    /* pieces of neighbouring rows follow each other: they share most of their source */
    const ptrdiff_t n_pieces = (plan->out_width + SEGMENT - 1) / SEGMENT;
    for (ptrdiff_t band = first; band < last; band += BAND) {
        ptrdiff_t n_rows = last - band < BAND ? last - band : BAND;
        for (ptrdiff_t k = 0; k < n_pieces * n_rows; ++k) {
            ptrdiff_t y = band + k % n_rows, start = k / n_rows * SEGMENT;
            ptrdiff_t left = plan->out_width - start;
            int n_pixels = left < SEGMENT ? (int)left : SEGMENT, n_blocks = (n_pixels + 7) / 8;
            if (plan->map.step) {
                NAME(nodes_of_row)(&plan->map, y, start, n_pixels, map);
                NAME(sample)(plan, source, map, stored, n_blocks);
            } else {
                NAME(take)(plan, source, start, y, n_pixels, stored);
            }
            if (plan->has_colour) {
                if (plan->gain.step) {
                    NAME(nodes_of_row)(&plan->gain, y, start, n_pixels, gain);
                }
                for (int c = 0; c < 3; ++c) NAME(light)(plan, c, gain[c], rgb[c], n_blocks);
                if (plan->is_pairs) {
                    NAME(colour_by_pairs)(plan, rgb, n_blocks);
                } else {
                    NAME(colour)(plan, rgb, n_blocks);
                }
            }
            for (int c = 0; c < plan->n_channels; ++c) NAME(scale)(plan, stored[c], n_blocks);
            NAME(store)(plan, stored, (uint8_t *)out.data + y * out.stride + start * pixel,
                        n_pixels);
        }
    }
}
