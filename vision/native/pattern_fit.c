/* Drawn patterns fitted to readings by expectation maximisation: light, ground, outliers and noise of each.
 *
 * With x and y from the middle, in sides, the readings are b + c w + (g x + h y) + (p x + q y) w [+ d r] under a pattern of
 * whiteness w. Each step solves for the levels under the shares that parts are no outliers, then for the noise, then for
 * the shares. Parts are read by columns of LANES; lanes beyond the square are not seen. As y is the same along a row,
 * sums over a column of lanes need its powers alone, and x is applied once, to the sums.
 */
#define FLOATS_LANES 8 /* sums over its lanes are added up, and are the same in all builds */
#include "pattern_fit.h"
#include "floats.h"

#include <stdlib.h>
#include <string.h>

enum {
    MAX_SIDE = PARTS * (MAX_CELLS + 2), MAX_BLOCKS = (MAX_SIDE + LANES - 1) / LANES, LEVELS = 7,
    ROWS_PER_LOG = 12 /* densities lie between 0.01 and 100: so many of them, of all lanes, do not overflow */
};

/* Planes of one candidate and pattern: `block * side + row` has LANES parts of a row. */
typedef struct {
    Floats values[MAX_BLOCKS * MAX_SIDE], seen[MAX_BLOCKS * MAX_SIDE], white[MAX_BLOCKS * MAX_SIDE];
    Floats ground[MAX_BLOCKS * MAX_SIDE], share[MAX_BLOCKS * MAX_SIDE], errors[MAX_BLOCKS * MAX_SIDE];
    Floats x[MAX_BLOCKS], on_card[MAX_BLOCKS]; /* on_card: 1 within the marker's columns, else 0 */
    float y[MAX_SIDE];
    int32_t side, blocks, has_ground;
} Planes;

/* Weighted sums of products, by powers of y; lanes are added up by `normal_equations`. */
typedef struct {
    Floats one[3], white[3], square[3];     /* weights s, s w and s w² */
    Floats value[2], shaded[2];             /* s v and s w v, with v the readings */
    Floats ground[2], ground_white[2], ground_square, ground_value; /* s r, s r w, s r² and s r v */
} Sums;

static inline int is_on_card(const Planes *planes, int32_t row) { return row >= PARTS && row < planes->side - PARTS; }

static void read_plane(const float *from, const Planes *planes, float scale, Floats *to) {
    const int32_t side = planes->side;
    for (int32_t block = 0; block < planes->blocks; block++) {
        const int32_t first = block * LANES, lanes = side - first < LANES ? side - first : LANES;
        for (int32_t row = 0; row < side; row++) {
            Floats parts = {0};
            memcpy(&parts, from + row * side + first, (size_t)lanes * sizeof *from);
            to[block * side + row] = parts * scale;
        }
    }
}

static void place_parts(Planes *planes, int32_t n) {
    planes->side = PARTS * (n + 2);
    planes->blocks = (planes->side + LANES - 1) / LANES;
    for (int32_t k = 0; k < planes->blocks * LANES; k++) {
        const float place = (((float)k + 0.5f) / PARTS - 1) / (float)n - 0.5f;
        planes->x[k / LANES][k % LANES] = place;
        planes->on_card[k / LANES][k % LANES] = is_on_card(planes, k);
        if (k < planes->side) planes->y[k] = place;
    }
}

/* Set the shares of the first step. */
static void begin(Planes *planes, const PatternConstants *constants) {
    const float zone = (float)constants->first_zone_share;
    for (int32_t block = 0; block < planes->blocks; block++)
        for (int32_t row = 0; row < planes->side; row++) {
            const int32_t at = block * planes->side + row;
            const Floats card = is_on_card(planes, row) ? planes->on_card[block] : all(0.0f);
            planes->share[at] = planes->seen[at] * (zone + (1 - zone) * card);
        }
}

INLINE void add_powers(Floats weight, float y, int powers, Floats *sums) {
    sums[0] += weight;
    sums[1] += weight * y;
    if (powers > 2) sums[2] += weight * (y * y);
}

INLINE Sums add_column(const Planes *planes, int32_t block, int has_ground) {
    Sums sums = {0};
    for (int32_t row = 0; row < planes->side; row++) {
        const int32_t at = block * planes->side + row;
        const float y = planes->y[row];
        const Floats share = planes->share[at], white = planes->white[at], value = planes->values[at];
        const Floats shaded = share * white;
        add_powers(share, y, 3, sums.one);
        add_powers(shaded, y, 3, sums.white);
        add_powers(shaded * white, y, 3, sums.square);
        add_powers(share * value, y, 2, sums.value);
        add_powers(shaded * value, y, 2, sums.shaded);
        if (!has_ground) continue;
        const Floats ground = share * planes->ground[at];
        add_powers(ground, y, 2, sums.ground);
        add_powers(ground * white, y, 2, sums.ground_white);
        sums.ground_square += ground * planes->ground[at];
        sums.ground_value += ground * value;
    }
    return sums;
}

static double lane_sum(Floats lanes) {
    double sum = 0;
    for (int i = 0; i < LANES; i++) sum += (double)lanes[i];
    return sum;
}

/* Sums of 1, x, y, x², x y and y², or of 1, x and y alone, times a weight. */
typedef struct { Floats one, x, y, xx, xy, yy; } Moments;

static void add_moments(Moments *moments, const Floats *sums, Floats x, int powers) {
    moments->one += sums[0];
    moments->x += sums[0] * x;
    moments->y += sums[1];
    if (powers < 3) return;
    moments->xx += sums[0] * x * x;
    moments->xy += sums[1] * x;
    moments->yy += sums[2];
}

typedef struct { double a[LEVELS][LEVELS], right[LEVELS]; } Normal;

static void put_square(Normal *normal, const Moments *moments, int row, int column) {
    const double products[3][3] = {
        {lane_sum(moments->one), lane_sum(moments->x), lane_sum(moments->y)},
        {0, lane_sum(moments->xx), lane_sum(moments->xy)},
        {0, 0, lane_sum(moments->yy)},
    };
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) normal->a[row + i][column + j] = products[i < j ? i : j][i < j ? j : i];
}

static void put_column(double *to, const Moments *moments) {
    to[0] = lane_sum(moments->one);
    to[1] = lane_sum(moments->x);
    to[2] = lane_sum(moments->y);
}

/* Compute the lower triangle of the normal matrix and the right side of b, g, h, c, p, q and d. */
static void normal_equations(const Planes *planes, double gradient_ridge, double ridge, Normal *normal) {
    Moments one = {0}, white = {0}, square = {0}, value = {0}, shaded = {0}, ground = {0}, ground_white = {0};
    Floats ground_square = {0}, ground_value = {0};
    for (int32_t block = 0; block < planes->blocks; block++) {
        const Floats x = planes->x[block];
        const Sums sums = planes->has_ground ? add_column(planes, block, 1) : add_column(planes, block, 0);
        add_moments(&one, sums.one, x, 3);
        add_moments(&white, sums.white, x, 3);
        add_moments(&square, sums.square, x, 3);
        add_moments(&value, sums.value, x, 2);
        add_moments(&shaded, sums.shaded, x, 2);
        add_moments(&ground, sums.ground, x, 2);
        add_moments(&ground_white, sums.ground_white, x, 2);
        ground_square += sums.ground_square;
        ground_value += sums.ground_value;
    }
    put_square(normal, &one, 0, 0);
    put_square(normal, &white, 3, 0);
    put_square(normal, &square, 3, 3);
    put_column(normal->right, &value);
    put_column(normal->right + 3, &shaded);
    put_column(normal->a[6], &ground);
    put_column(normal->a[6] + 3, &ground_white);
    normal->a[6][6] = lane_sum(ground_square) + ridge;
    normal->right[6] = lane_sum(ground_value);
    for (int i = 0; i < 6; i++) normal->a[i][i] += i % 3 ? gradient_ridge : ridge;
}

/* Solve by L D Lᵀ in place. Pivots that rounding makes smaller than the ridge are the ridge. */
static void solve_levels(Normal *normal, int count, double ridge, double *levels) {
    double (*a)[LEVELS] = normal->a;
    for (int i = 0; i < count; i++) {
        for (int j = 0; j < i; j++) {
            double sum = a[i][j];
            for (int k = 0; k < j; k++) sum -= a[i][k] * a[j][k] * a[k][k];
            a[i][j] = sum / a[j][j];
        }
        double pivot = a[i][i];
        for (int k = 0; k < i; k++) pivot -= a[i][k] * a[i][k] * a[k][k];
        a[i][i] = pivot > ridge ? pivot : ridge;
        levels[i] = normal->right[i];
        for (int k = 0; k < i; k++) levels[i] -= a[i][k] * levels[k];
    }
    for (int i = count - 1; i >= 0; i--) {
        levels[i] /= a[i][i];
        for (int k = i + 1; k < count; k++) levels[i] -= a[k][i] * levels[k];
    }
}

/* What the parts on the marker leave: shares, and shares times squared errors. */
typedef struct { double used, spread; } Spread;

static Spread leave_errors(Planes *planes, const double *levels) {
    Floats used = {0}, spread = {0};
    float by[LEVELS];
    for (int i = 0; i < LEVELS; i++) by[i] = (float)levels[i];
    for (int32_t block = 0; block < planes->blocks; block++) {
        const Floats light_x = by[1] * planes->x[block], factor_x = by[4] * planes->x[block];
        for (int32_t row = 0; row < planes->side; row++) {
            const int32_t at = block * planes->side + row;
            const float light_y = by[0] + by[2] * planes->y[row], factor_y = by[3] + by[5] * planes->y[row];
            Floats error = planes->values[at] - (light_x + light_y) - planes->white[at] * (factor_x + factor_y);
            if (planes->has_ground) error -= by[6] * planes->ground[at];
            planes->errors[at] = error;
            if (!is_on_card(planes, row)) continue;
            const Floats share = planes->on_card[block] * planes->share[at];
            used += share;
            spread += share * error * error;
        }
    }
    return (Spread){lane_sum(used), lane_sum(spread)};
}

static double log_product(Floats lanes) {
    double product = 1;
    for (int i = 0; i < LANES; i++) product *= (double)lanes[i];
    return log(product);
}

/* Compute the shares that parts are no outliers, and return the sum of the log densities. */
static double share_out(Planes *planes, const PatternConstants *constants, double std) {
    const float card = (float)constants->card_outliers, zone = (float)constants->zone_outliers;
    const float per_std = (float)(1 / std), per_range = (float)(1 / constants->outlier_range);
    double logs = 0;
    for (int32_t block = 0; block < planes->blocks; block++) {
        const Floats in_card_rows = zone + (card - zone) * planes->on_card[block];
        Floats product = all(1.0f);
        for (int32_t row = 0; row < planes->side; row++) {
            const int32_t at = block * planes->side + row;
            const Floats prior = is_on_card(planes, row) ? in_card_rows : all(zone);
            const Floats inlier = (1.0f - prior) * per_std * bell(planes->errors[at] * per_std);
            const Floats density = inlier + prior * per_range, seen = planes->seen[at];
            planes->share[at] = seen * inlier / density;
            product *= choose(seen > 0.0f, density, all(1.0f));
            if (row % ROWS_PER_LOG != ROWS_PER_LOG - 1 && row != planes->side - 1) continue;
            logs += log_product(product);
            product = all(1.0f);
        }
    }
    return logs;
}

static double outlier_share(const Planes *planes) {
    Floats used = {0};
    for (int32_t block = 0; block < planes->blocks; block++)
        for (int32_t row = PARTS; row < planes->side - PARTS; row++)
            used += planes->on_card[block] * planes->share[block * planes->side + row];
    const double along = planes->side - 2 * PARTS;
    return 1 - lane_sum(used) / (along * along);
}

/* Fit one pattern to candidate k, whose planes have been read. */
static PatternFit fit_pattern(const PatternRequest *given, Planes *planes, int64_t k) {
    static const int by_name[6] = {0, 3, 1, 2, 4, 5}; /* b, c, g, h, p and q among the levels */
    const PatternConstants *constants = given->constants;
    const double scale = given->scales[k], rounding = constants->rounding_std / scale;
    const double usual = constants->usual_std_parts * constants->usual_std * constants->usual_std;
    double std = constants->first_std, logs = 0, levels[LEVELS] = {0};
    begin(planes, constants);
    for (int64_t step = 0; step < constants->iterations; step++) {
        Normal normal;
        const double per_gradient = std / constants->gradient_std;
        normal_equations(planes, per_gradient * per_gradient * PARTS * PARTS, constants->ridge, &normal);
        solve_levels(&normal, planes->has_ground ? LEVELS : LEVELS - 1, constants->ridge, levels);
        const Spread left = leave_errors(planes, levels);
        std = sqrt((usual + left.spread) / (constants->usual_std_parts + left.used) + rounding * rounding);
        logs = share_out(planes, constants, std);
    }
    PatternFit fit = {.log = given->weights[k] * logs, .std = std, .outlier_share = outlier_share(planes)};
    for (int i = 0; i < 6; i++) {
        const double level = levels[by_name[i]], gradient = level / constants->gradient_std;
        if (i > 1) fit.log -= 0.5 * gradient * gradient;
        fit.levels[i] = level * scale;
    }
    const double contrast = fmax(fit.levels[1], constants->min_contrast);
    const double short_by = given->any_contrast ? 0 : fmin(log(contrast / given->ranges[k]), 0.0) / constants->log_contrast_std;
    fit.log -= 0.5 * short_by * short_by;
    if (!(fit.levels[1] >= constants->min_contrast)) fit.log = -INFINITY;
    return fit;
}

/* Fit patterns (count, each) to the readings of candidates. Returns 0 or an error. */
int32_t fit_patterns(const PatternRequest *given, PatternFit *fits) {
    const int has_grounds = given->grounds == 1 || given->grounds == given->count;
    if (given->n <= 0 || given->n > MAX_CELLS || given->count < 0 || given->each < 0 || (given->grounds && !has_grounds))
        return FIT_INVALID_SIZE;
    void *memory = malloc(sizeof(Planes) + sizeof(Floats));
    if (!memory) return FIT_NO_MEMORY;
    Planes *planes = (Planes *)((uintptr_t)memory + sizeof(Floats) - (uintptr_t)memory % sizeof(Floats));
    place_parts(planes, given->n);
    planes->has_ground = given->grounds > 0;
    const int64_t parts = (int64_t)planes->side * planes->side;
    for (int64_t k = 0; k < given->count; k++) {
        read_plane(given->levels + k * parts, planes, (float)(1 / given->scales[k]), planes->values);
        read_plane(given->seen + k * parts, planes, 1, planes->seen);
        if (given->grounds == given->count || (planes->has_ground && k == 0))
            read_plane(given->ground_shares + (given->grounds == given->count ? k : 0) * parts, planes, 1, planes->ground);
        for (int64_t i = k * given->each; i < (k + 1) * given->each; i++) {
            read_plane(given->patterns + i * parts, planes, 1, planes->white);
            fits[i] = fit_pattern(given, planes, k);
        }
    }
    free(memory);
    return 0;
}
