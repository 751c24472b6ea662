/* What a correction needs to know, compiled once; see correct.h for what it does. */
#ifndef CALICHROME_PLAN_H
#define CALICHROME_PLAN_H

#include <stddef.h>
#include <stdint.h>

enum { MAX_TERMS = 24, N_FACTORS = 15, MAX_STEP = 8, NODE_PADDING = 16, N_POWERS = 7 };
enum { SEGMENT = 512, NODES = SEGMENT + NODE_PADDING, BAND = 16 }; /* pixels of a row done at a time */

typedef float floats_t __attribute__((vector_size(32)));
typedef int32_t ints_t __attribute__((vector_size(32)));

enum pixel_type { UINT8 = 1, UINT16 = 2, FLOAT32 = 4 }; /* bytes of a stored number */

/* Things that factors of terms are made of, computed only where a term asks for them. */
enum feature { FEATURE_ROOTS = 1, FEATURE_CUBE_ROOTS = 2, FEATURE_HUE = 4 };

/* Values at every step-th pixel of the output, linear in between; padded rows. */
typedef struct {
    int step;         /* 1, 2, 4 or 8; 0: there is no grid */
    ptrdiff_t pitch;  /* floats from one row of nodes to the next */
    ptrdiff_t height; /* rows of nodes */
    int n_planes;
    float *nodes; /* (n_planes, height, pitch) */
} grid_t;

/* A power law with a linear foot: a polynomial, and a straight line from 0 to where that begins. */
typedef struct {
    float powers[N_POWERS]; /* lowest first */
    float foot_end, foot_slope;
} curve_t;

/* How stored values become linear light. */
enum linearisation { LINEAR, BY_CURVE, BY_TABLE };

typedef struct {
    ptrdiff_t in_width, in_height, out_width, out_height;
    int n_channels; /* 3, or 1: geometry alone */
    int in_type, out_type;
    int is_bgr, has_colour;
    float full_scale; /* of stored numbers */

    grid_t map;  /* x, y of the source, pixels */
    grid_t gain; /* what linear values are multiplied by; without it: balance */
    float balance[3];

    int linearisation;
    curve_t curve;     /* of stored values */
    int n_linear;      /* entries of each table */
    float *linear;     /* (3, n_linear + 1), the last entry twice */

    int features, n_terms, is_pairs; /* of roots, in the order RG GB BR: the usual model */
    uint8_t factors[MAX_TERMS][3];
    float coefficients[MAX_TERMS][3];
    float matrix[9], offset[3];
    float pair_matrix[9]; /* of what two roots differ by, squared */
    float lifted_matrix[9], lift, lifted_grey;

    int table_size; /* nodes along an edge; 0: there is no table */
    float table_scale[3];
    float *table; /* (size, size, size, 4), the fourth channel unused */

    int clips;      /* to 0..1 */
    int is_encoded;
    curve_t encoding; /* of the fourth root of light; its foot is of light */
    float out_scale;
} plan_t;

typedef floats_t *const planes_t[3]; /* channels of a piece of a row */

/* Which two of eight consecutive nodes each of eight pixels lies between, and where. */
typedef struct {
    ints_t left;
    floats_t share;
} between_t;

typedef struct {
    const uint8_t *data;
    ptrdiff_t stride; /* bytes from row to row, of either sign */
} picture_t;

typedef void rows_function(const plan_t *, picture_t source, picture_t out, ptrdiff_t first,
                           ptrdiff_t last);

/* Planar YUV and packed RGB of one frame, 8 bits, and the matrix from one to the other. */
typedef struct {
    ptrdiff_t width, height;
    picture_t luma, chroma[2], rgb;
    float matrix[3][4]; /* the fourth column is added */
} yuv_t;

typedef void yuv_function(const yuv_t *);

#endif
