/* Evidence of markers' residuals for a streak of motion blur (fitting/streak_evidence.py).
 *
 * A change δQ of the streak changes a marker's pixels by X δQ. With the columns J, residuals r and C = (JᵀJ)⁻¹, the
 * information is M = (XᵀX - XᵀJ C JᵀX) / σ² and the score b = Xᵀr / σ², where r are residuals of the model's solution.
 */
#include "marker_pixels.h"

enum { PARTS = 2 };

/* Products of the two parts of X: with the columns and the pixels, and with each other. */
typedef struct { double columns[COLUMNS][PARTS], own[PARTS][PARTS]; } Products;

/* Compute how T_xx, T_xy and T_yy make up X: `(dS_xx T_xx + dS_yy T_yy) / 2 + dS_xy T_xy`, times the contrast. */
static void derivative_maps(const Homography *at, double contrast, float maps[3][PARTS]) {
    const Complex parts[PARTS] = {{1, 0}, {0, 1}};
    for (int part = 0; part < PARTS; part++) {
        double table[3];
        streak_moments(at, parts[part], table);
        maps[0][part] = (float)(contrast * table[0] / 2);
        maps[1][part] = (float)(contrast * table[2]);
        maps[2][part] = (float)(contrast * table[1] / 2);
    }
}

static Products products_of(const Pixels *own, float maps[3][PARTS]) {
    Doubles columns[COLUMNS][PARTS] = {{{0}}}, squares[PARTS][PARTS] = {{{0}}};
    for (int64_t at = 0; at < own->bounds[1] * BLOCK_PX; at += LANES) {
        const int64_t block = at / BLOCK_PX, first = at % BLOCK_PX;
        const float *bends = own->bends + block * (3 * BLOCK_PX) + first;
        const float *values = own->columns + block * (COLUMNS * BLOCK_PX) + first;
        Floats x[PARTS];
        for (int part = 0; part < PARTS; part++)
            x[part] = load(bends) * maps[0][part] + load(bends + BLOCK_PX) * maps[1][part] +
                      load(bends + 2 * BLOCK_PX) * maps[2][part];
        for (int part = 0; part < PARTS; part++) {
            for (int c = 0; c < COLUMNS; c++) add_in_double(load(values + c * BLOCK_PX) * x[part], &columns[c][part]);
            for (int other = 0; other < PARTS; other++) add_in_double(x[part] * x[other], &squares[part][other]);
        }
    }
    Products total;
    for (int part = 0; part < PARTS; part++) {
        for (int c = 0; c < COLUMNS; c++) total.columns[c][part] = sum_of(columns[c][part]);
        for (int other = 0; other < PARTS; other++) total.own[part][other] = sum_of(squares[part][other]);
    }
    return total;
}

/* Write M (2, 2) and b (2,) of marker k. */
static void write_evidence(const Products *products, const Solutions *solutions, int64_t k, double *information,
                           double *score) {
    const double *c = solutions->inverse_normals + k * UNKNOWNS * UNKNOWNS, *values = solutions->values + k * UNKNOWNS;
    const double variance = noise_variance(solutions, k);
    for (int part = 0; part < PARTS; part++) {
        score[part] = products->columns[PIXEL][part];
        for (int i = 0; i < UNKNOWNS; i++) score[part] -= products->columns[i][part] * values[i];
        score[part] /= variance;
        for (int other = 0; other < PARTS; other++) {
            double explained = 0;
            for (int i = 0; i < UNKNOWNS; i++)
                for (int j = 0; j < UNKNOWNS; j++)
                    explained += products->columns[i][part] * c[i * UNKNOWNS + j] * products->columns[j][other];
            information[part * PARTS + other] = (products->own[part][other] - explained) / variance;
        }
    }
}

/* Compute the evidence of settled markers for a change of the request's streak.
 *
 * informations (count, 2, 2), 1/px⁴, and scores (count, 2), 1/px², are results. Returns 0 or an error. */
int32_t streak_evidence(const FitRequest *given, double *informations, double *scores) {
    if (!is_request_valid(given) || !given->has_streak) return FIT_INVALID_SIZE;
    Pixels pixels = {0};
    Solutions solutions;
    int32_t result = allocate_solutions(&solutions, given->count);
    for (int64_t k = 0; !result && k < given->count; k++) {
        result = draw_marker(given, given->start + k, given->appearances + k, 1, &pixels, k);
        if (result) break;
        solve_marker(given, &pixels, pixels.count, &solutions, k);
        float maps[3][PARTS];
        derivative_maps(given->start + k, contrast_of(&solutions, k, given->constants), maps);
        const Products products = products_of(&pixels, maps);
        write_evidence(&products, &solutions, k, informations + 4 * k, scores + 2 * k);
    }
    release_pixels(&pixels);
    release_solutions(&solutions);
    return result;
}
