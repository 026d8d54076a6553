/* The filter's work for fifteen states, written by hand: what the processor could do.
 *
 * Invariant error state, rotating Earth, no optional states, IMU and DVL in base_link. The equations
 * are those of navigation/prediction/strapdown.py, error_state.py, kalman.py and coordinates.py, where they are
 * documented; speed.py holds the results of both against each other to 1e-12. Not in here is what is
 * no mathematics of the filter: the order of events, the checks of samples and claims, the gate.
 *
 * Rows of matrices are padded to sixteen, so that four vectors of four doubles make a row. The
 * compiler lowers the vectors to what the processor has.
 */
#include <math.h>
#include <string.h>

enum { V = 0, A = 3, BF = 6, BW = 9, P = 12, N = 15, ROW = 16, LANES = 4 };

typedef double vec __attribute__((vector_size(32)));

static const double SEMI_MAJOR_AXIS = 6378137.0;
static const double FLATTENING = 1.0 / 298.257223563;
static const double EARTH_RATE = 7.292115e-5;
static const double GM = 3.986004418e14;
static const double EQUATOR_GRAVITY = 9.7803253359;
static const double SOMIGLIANA = 0.00193185265241;
static const double MAX_DEPTH = 12000.0;
static const double PRODUCT = 1e-3;

typedef struct {
    double C[9], v[3], llh[3], llh_r[3], bend[2], b_f[3], b_w[3], w_before[3];
    double seconds, h_0, padding[5];
    double P[N][ROW] __attribute__((aligned(32)));
} State;

typedef struct {
    double S_f, S_w, eps_f, eps_w; /* densities; those of the samples are equal for the three axes */
} Noise;

/* ------------------------------------------------------------------ vectors and rotations */

static inline void cross(double *o, const double *a, const double *b)
{
    o[0] = a[1] * b[2] - a[2] * b[1];
    o[1] = a[2] * b[0] - a[0] * b[2];
    o[2] = a[0] * b[1] - a[1] * b[0];
}

static inline void rotate(double *o, const double *M, const double *x)
{
    for (int i = 0; i < 3; i++)
        o[i] = M[3 * i] * x[0] + M[3 * i + 1] * x[1] + M[3 * i + 2] * x[2];
}

static inline void rotate_back(double *o, const double *M, const double *x)
{
    for (int i = 0; i < 3; i++)
        o[i] = M[i] * x[0] + M[3 + i] * x[1] + M[6 + i] * x[2];
}

static inline void product(double *o, const double *X, const double *Y)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            o[3 * i + j] = X[3 * i] * Y[j] + X[3 * i + 1] * Y[3 + j] + X[3 * i + 2] * Y[6 + j];
}

static inline void product_transposed(double *o, const double *X, const double *Y)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            o[3 * i + j] = X[3 * i] * Y[3 * j] + X[3 * i + 1] * Y[3 * j + 1] + X[3 * i + 2] * Y[3 * j + 2];
}

static inline void skew(double *o, const double *a)
{
    const double m[9] = {0, -a[2], a[1], a[2], 0, -a[0], -a[1], a[0], 0};
    memcpy(o, m, sizeof m);
}

static inline void polynomial(double *o, double a, double b, double x, double y, double z)
{
    o[0] = 1.0 - b * (y * y + z * z), o[1] = -a * z + b * x * y, o[2] = a * y + b * x * z;
    o[3] = a * z + b * x * y, o[4] = 1.0 - b * (x * x + z * z), o[5] = -a * x + b * y * z;
    o[6] = -a * y + b * x * z, o[7] = a * x + b * y * z, o[8] = 1.0 - b * (x * x + y * y);
}

static inline void exponential(double *R, double *mean, double x, double y, double z)
{
    const double t = x * x + y * y + z * z;
    double a, b, c;
    if (t < 1e-4) {
        a = 1.0 - t / 6.0 * (1.0 - t / 20.0);
        b = 0.5 - t / 24.0 * (1.0 - t / 30.0);
        c = 1.0 / 6.0 - t / 120.0 * (1.0 - t / 42.0);
    } else {
        const double angle = sqrt(t);
        a = sin(angle) / angle;
        b = (1.0 - cos(angle)) / t;
        c = (1.0 - a) / t;
    }
    polynomial(R, a, b, x, y, z);
    if (mean)
        polynomial(mean, b, c, x, y, z);
}

static inline void orthonormalise(double *C)
{
    double s[9], o[9];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            s[3 * i + j] = (i == j ? 1.5 : 0.0) - 0.5 * (C[i] * C[j] + C[3 + i] * C[3 + j] + C[6 + i] * C[6 + j]);
    product(o, C, s);
    memcpy(C, o, sizeof o);
}

/* ------------------------------------------------------------------ the Earth */

static inline void radii(double lat, double *R_N, double *R_E)
{
    const double e2 = FLATTENING * (2.0 - FLATTENING), sine = sin(lat), s = 1.0 - e2 * sine * sine;
    *R_E = SEMI_MAJOR_AXIS / sqrt(s);
    *R_N = *R_E * (1.0 - e2) / s;
}

static inline double gravity(double lat, double h)
{
    const double e2 = FLATTENING * (2.0 - FLATTENING), sine = sin(lat), s2 = sine * sine, a = SEMI_MAJOR_AXIS;
    const double m = EARTH_RATE * EARTH_RATE * a * a * a * (1.0 - FLATTENING) / GM;
    const double g_0 = EQUATOR_GRAVITY * (1.0 + SOMIGLIANA * s2) / sqrt(1.0 - e2 * s2);
    return g_0 * (1.0 - 2.0 / a * (1.0 + FLATTENING * (1.0 - 2.0 * s2) + m) * h + 3.0 * h * h / (a * a));
}

static inline double wrapped(double angle)
{
    return angle - 2.0 * M_PI * rint(angle / (2.0 * M_PI));
}

static inline void displacement(double *d, const double *place, const double *to)
{
    const double lat = 0.5 * (place[0] + to[0]), h = 0.5 * (place[2] + to[2]);
    double R_N, R_E;
    radii(lat, &R_N, &R_E);
    d[0] = (R_N + h) * (to[0] - place[0]);
    d[1] = (R_E + h) * cos(lat) * wrapped(to[1] - place[1]);
    d[2] = place[2] - to[2];
}

static inline void move(double *place, const double *d)
{
    const double h = place[2] - 0.5 * d[2], lat_0 = place[0];
    double lat = lat_0, R_N, R_E;
    for (int i = 0; i < 4; i++) {
        radii(0.5 * (lat_0 + lat), &R_N, &R_E);
        lat = lat_0 + d[0] / (R_N + h);
    }
    place[0] = lat;
    place[1] = wrapped(place[1] + d[1] / ((R_E + h) * cos(0.5 * (lat_0 + lat))));
    place[2] -= d[2];
}

/* ------------------------------------------------------------------ one sample */

typedef struct {
    double C[9], f[3], g, v[3], x[3], w_ie[3], w_en[3], w_in[3], W[9], coriolis[3];
} Middle;

static inline void navigation_rate(Middle *m, const double *v)
{
    rotate(m->w_en, m->W, v);
    for (int i = 0; i < 3; i++)
        m->w_in[i] = m->w_ie[i] + m->w_en[i];
}

static inline void acceleration(Middle *m, const double *v, double *a)
{
    for (int i = 0; i < 3; i++)
        m->coriolis[i] = 2.0 * m->w_ie[i] + m->w_en[i];
    cross(a, m->coriolis, v);
    for (int i = 0; i < 3; i++)
        a[i] = m->f[i] + (i == 2 ? m->g : 0.0) - a[i];
}

static void mechanise(State *s, Middle *m, const double *f, const double *w, const double *coning, double dt)
{
    const double half = 0.5 * dt;
    const double lat = s->llh[0] + half * s->v[0] / SEMI_MAJOR_AXIS;
    double h = s->llh[2] - half * s->v[2], R_N, R_E, a[3], d[3];
    h = fmin(fmax(h, s->h_0 - MAX_DEPTH), s->h_0 + MAX_DEPTH);
    radii(lat, &R_N, &R_E);
    const double cosine = cos(lat);
    m->g = gravity(lat, h);
    m->w_ie[0] = EARTH_RATE * cosine, m->w_ie[1] = 0.0, m->w_ie[2] = -EARTH_RATE * sin(lat);
    memset(m->W, 0, sizeof m->W);
    m->W[1] = 1.0 / (R_E + h), m->W[3] = -1.0 / (R_N + h), m->W[7] = -tan(lat) / (R_E + h);
    navigation_rate(m, s->v);

    double turn[9], mean[9], frame[9], rotated[9];
    exponential(turn, mean, (w[0] + coning[0]) * dt, (w[1] + coning[1]) * dt, (w[2] + coning[2]) * dt);
    exponential(frame, 0, -m->w_in[0] * half, -m->w_in[1] * half, -m->w_in[2] * half);
    product(rotated, s->C, mean);
    product(m->C, frame, rotated);
    rotate(m->f, m->C, f);

    acceleration(m, s->v, a);
    for (int i = 0; i < 3; i++)
        m->v[i] = s->v[i] + half * a[i];
    navigation_rate(m, m->v);
    acceleration(m, m->v, a);
    displacement(m->x, s->llh_r, s->llh);
    for (int i = 0; i < 3; i++) {
        m->x[i] += half * s->v[i];
        d[i] = dt * (s->v[i] + half * a[i]);
        s->v[i] += dt * a[i];
    }
    s->llh[0] += d[0] / (R_N + h);
    s->llh[1] = wrapped(s->llh[1] + d[1] / ((R_E + h) * cosine));
    s->llh[2] -= d[2];

    product(rotated, s->C, turn);
    exponential(frame, 0, -m->w_in[0] * dt, -m->w_in[1] * dt, -m->w_in[2] * dt);
    product(s->C, frame, rotated);
    orthonormalise(s->C);
}

static inline void set_block(double M[][ROW], int row, int column, double sign, const double *B)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            M[row + i][column + j] = sign * B[3 * i + j];
}

/* Slope of the heading in the Earth's rotation, and densities of what it leaves. */
static inline double earth_rate_seen(const State *s, const Middle *m, double *rest)
{
    const double variance = s->P[A + 2][A + 2], one = exp(-0.5 * variance), two = exp(-2.0 * variance);
    const double sine = fmax(0.5 * (1.0 - two) - one * one * variance, 0.0);
    const double cosine = fmax(1.0 - 2.0 * one + 0.5 * (1.0 + two), 0.0);
    const double bias = (s->P[BW][BW] + s->P[BW + 1][BW + 1] + s->P[BW + 2][BW + 2]) / 3.0;
    const double rate = m->w_ie[0] * m->w_ie[0], twice = 2.0 * s->seconds;
    const double north = cosine * rate, east = sine * rate;
    rest[0] = north > 0.0 ? twice * north * north / (north + bias) : 0.0;
    rest[1] = east > 0.0 ? twice * east * east / (east + bias) : 0.0;
    return one;
}

/* Rows of velocity, attitude and position: F, then Phi = I + F dt + (F dt)^2 / 2. */
static void transition(const Middle *m, double slope, double dt, double Phi[][ROW])
{
    double F[N][ROW] __attribute__((aligned(32))), M[9], B[9], v_x[9], x_x[9];
    memset(F, 0, sizeof F);
    skew(v_x, m->v);
    skew(x_x, m->x);
    skew(M, m->coriolis);
    set_block(F, V, V, -1.0, M);
    set_block(F, V, BF, -1.0, m->C);
    set_block(F, A, V, -1.0, m->W);
    set_block(F, A, BW, -1.0, m->C);
    skew(M, m->w_ie);
    M[5] *= slope;
    product(B, v_x, M);
    B[1] -= m->g;
    B[3] += m->g;
    set_block(F, V, A, 1.0, B);
    product(B, v_x, m->C);
    set_block(F, V, BW, -1.0, B);
    product(B, m->W, v_x);
    skew(M, m->w_in);
    for (int i = 0; i < 9; i++)
        B[i] -= M[i];
    B[5] -= (1.0 - slope) * m->w_ie[0];
    set_block(F, A, A, 1.0, B);
    product(M, x_x, B);
    set_block(F, P, A, 1.0, M);
    product(M, x_x, m->W);
    set_block(F, P, V, -1.0, M);
    product(M, x_x, m->C);
    set_block(F, P, BW, -1.0, M);
    for (int i = 0; i < 3; i++)
        F[P + i][V + i] += 1.0;

    static const int rows[9] = {0, 1, 2, 3, 4, 5, 12, 13, 14};
    for (int r = 0; r < 9; r++) {
        const int i = rows[r];
        vec square[3] = {{0}, {0}, {0}};
        for (int k = 0; k < BF; k++) {
            const vec *row = (const vec *)F[k];
            for (int q = 0; q < 3; q++)
                square[q] += F[i][k] * row[q];
        }
        vec *out = (vec *)Phi[i];
        const vec *row = (const vec *)F[i];
        for (int q = 0; q < 3; q++)
            out[q] = dt * (row[q] + (0.5 * dt) * square[q]);
        out[3] = (vec){0};
        if (i < P)
            Phi[i][i] += 1.0;
    }
}

/* Half of Q_d, of velocity, attitude and position; that of the biases is diagonal. */
static void half_noise(const Middle *m, const Noise *noise, const double *rest, double dt, double Q[][ROW])
{
    double X[9], Y[9], Z[9], W[9], v_x[9], x_x[9], half = 0.5 * dt;
    product_transposed(X, m->C, m->C);
    for (int i = 0; i < 9; i++)
        Y[i] = noise->S_f * X[i], X[i] *= noise->S_w;
    X[0] += rest[0];
    X[4] += rest[1];
    set_block(Q, A, A, half, X);
    skew(v_x, m->v);
    skew(x_x, m->x);
    product(Z, v_x, X);
    set_block(Q, V, A, half, Z);
    product_transposed(W, Z, v_x);
    for (int i = 0; i < 9; i++)
        Y[i] += W[i];
    set_block(Q, V, V, half, Y);
    product(Z, x_x, X);
    set_block(Q, P, A, half, Z);
    product_transposed(W, Z, v_x);
    set_block(Q, P, V, half, W);
    product_transposed(Y, Z, x_x);
    set_block(Q, P, P, half, Y);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            Q[A + j][V + i] = Q[V + i][A + j];
            Q[A + j][P + i] = Q[P + i][A + j];
            Q[V + j][P + i] = Q[P + i][V + j];
        }
}

static void propagate(double M[][ROW], double Phi[][ROW], double Q[][ROW], const Noise *noise, double dt)
{
    static const int rows[9] = {0, 1, 2, 3, 4, 5, 12, 13, 14};
    double D[N][ROW] __attribute__((aligned(32))), T[P][ROW] __attribute__((aligned(32)));
    for (int r = 0; r < 9; r++) {
        vec *p = (vec *)M[rows[r]];
        const vec *q = (const vec *)Q[rows[r]];
        p[0] += q[0], p[1] += q[1], p[3] += q[3];
    }
    for (int i = 0; i < 3; i++) {
        M[BF + i][BF + i] += 0.5 * dt * noise->eps_f;
        M[BW + i][BW + i] += 0.5 * dt * noise->eps_w;
    }
    for (int r = 0; r < 9; r++) {
        const int i = rows[r];
        vec sum[4] = {{0}, {0}, {0}, {0}};
        if (i >= P)
            for (int q = 0; q < 4; q++)
                sum[q] = ((const vec *)M[i])[q];
        for (int k = 0; k < P; k++) {
            const vec *row = (const vec *)M[k];
            for (int q = 0; q < 4; q++)
                sum[q] += Phi[i][k] * row[q];
        }
        memcpy(D[i], sum, sizeof sum);
    }
    for (int k = 0; k < P; k++)
        for (int j = 0; j < N; j++)
            T[k][j] = j < BF || j >= P ? Phi[j][k] : 0.0;
    for (int k = 0; k < P; k++)
        T[k][N] = 0.0;
    for (int r = 0; r < 9; r++) {
        const int i = rows[r];
        const vec *q = (const vec *)Q[i];
        vec sum[4] = {q[0], q[1], {0}, q[3] + ((const vec *)D[i])[3]};
        for (int k = 0; k < P; k++) {
            const vec *row = (const vec *)T[k];
            sum[0] += D[i][k] * row[0];
            sum[1] += D[i][k] * row[1];
            sum[3] += D[i][k] * row[3];
        }
        double *out = M[i];
        const double *in = (const double *)sum;
        for (int j = 0; j < BF; j++)
            out[j] = in[j];
        for (int j = BF; j < P; j++)
            out[j] = D[i][j];
        for (int j = P; j < N; j++)
            out[j] = in[j];
    }
    for (int r = 0; r < 9; r++)
        for (int j = BF; j < P; j++)
            M[j][rows[r]] = M[rows[r]][j];
    for (int i = 0; i < N; i++) /* rounding must not make it asymmetric */
        for (int j = 0; j < i; j++)
            if ((i < BF || i >= P) && (j < BF || j >= P))
                M[j][i] = M[i][j];
    for (int i = 0; i < 3; i++) {
        M[BF + i][BF + i] += 0.5 * dt * noise->eps_f;
        M[BW + i][BW + i] += 0.5 * dt * noise->eps_w;
    }
}

static void bend(State *s, const Middle *m, double dt)
{
    double of_bias[2] = {0.0, 0.0}, (*M)[ROW] = s->P;
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 3; j++)
            of_bias[i] += M[P + i][BW + j] * m->C[6 + j];
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++)
            M[P + i][P + j] -= s->bend[i] * s->bend[j];
    s->bend[0] -= sqrt(3.0) * of_bias[1] * dt;
    s->bend[1] += sqrt(3.0) * of_bias[0] * dt;
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++)
            M[P + i][P + j] += s->bend[i] * s->bend[j];
}

static void predict(State *s, const Noise *noise, const double *f_b, const double *w_b, double dt)
{
    Middle m;
    double f[3], w[3], before[3], coning[3], rest[2];
    double Phi[N][ROW] __attribute__((aligned(32))), Q[N][ROW] __attribute__((aligned(32)));
    for (int i = 0; i < 3; i++) {
        f[i] = f_b[i] - s->b_f[i];
        w[i] = w_b[i] - s->b_w[i];
        before[i] = s->w_before[i] - s->b_w[i];
    }
    cross(coning, before, w);
    for (int i = 0; i < 3; i++)
        coning[i] *= dt / 12.0;
    mechanise(s, &m, f, w, coning, dt);
    const double slope = earth_rate_seen(s, &m, rest);
    transition(&m, slope, dt, Phi);
    memset(Q, 0, sizeof Q);
    half_noise(&m, noise, rest, dt, Q);
    propagate(s->P, Phi, Q, noise, dt);
    bend(s, &m, dt);
    memcpy(s->w_before, w_b, sizeof s->w_before);
    s->seconds += dt;
}

/* ------------------------------------------------------------------ one ping */

static double of_products(double M[][ROW], int j, int k, int a, int b)
{
    if (j == 2 || a == 2)
        return 0.0;
    return M[A + j][A + a] * M[V + k][V + b] + M[A + j][V + b] * M[A + a][V + k];
}

static void turn_block(double M[][ROW], int block, const double *R)
{
    double a[3], turned[3];
    for (int j = 0; j < N; j++) {
        for (int i = 0; i < 3; i++)
            a[i] = M[block + i][j];
        rotate(turned, R, a);
        for (int i = 0; i < 3; i++)
            M[block + i][j] = turned[i];
    }
    for (int i = 0; i < N; i++) {
        rotate(turned, R, &M[i][block]);
        for (int j = 0; j < 3; j++)
            M[i][block + j] = turned[j];
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < N; j++)
            M[j][block + i] = M[block + i][j];
}

static void inject(State *s, const double *dx)
{
    double turn[9], heading[9], rotated[9], tilted[3], before[3], after[3];
    const double sine = sin(dx[A + 2]), cosine = cos(dx[A + 2]);
    const double about_down[9] = {cosine, -sine, 0, sine, cosine, 0, 0, 0, 1};
    memcpy(heading, about_down, sizeof heading);
    for (int i = 0; i < 3; i++) {
        s->b_f[i] += dx[BF + i];
        s->b_w[i] += dx[BW + i];
    }
    exponential(turn, 0, dx[A], dx[A + 1], 0.0);
    product(rotated, turn, s->C);
    product(s->C, heading, rotated);
    orthonormalise(s->C);
    rotate(tilted, turn, s->v);
    for (int i = 0; i < 3; i++)
        tilted[i] += dx[V + i];
    rotate(s->v, heading, tilted);
    displacement(before, s->llh_r, s->llh);
    rotate(tilted, turn, before);
    for (int i = 0; i < 3; i++)
        tilted[i] += dx[P + i];
    rotate(after, heading, tilted);
    for (int i = 0; i < 3; i++)
        after[i] -= before[i];
    move(s->llh, after);
    turn_block(s->P, V, heading);
    turn_block(s->P, A, heading);
    turn_block(s->P, P, heading);
    const double north = s->bend[0], east = s->bend[1];
    s->bend[0] = heading[0] * north + heading[1] * east;
    s->bend[1] = heading[3] * north + heading[4] * east;
}

/* Inverse of a symmetric positive definite (3, 3) matrix. */
static void inverse(const double *S, double *o)
{
    const double c0 = S[4] * S[8] - S[5] * S[7], c1 = S[5] * S[6] - S[3] * S[8], c2 = S[3] * S[7] - S[4] * S[6];
    const double d = 1.0 / (S[0] * c0 + S[1] * c1 + S[2] * c2);
    o[0] = c0 * d, o[3] = c1 * d, o[6] = c2 * d;
    o[1] = (S[2] * S[7] - S[1] * S[8]) * d;
    o[4] = (S[0] * S[8] - S[2] * S[6]) * d;
    o[7] = (S[1] * S[6] - S[0] * S[7]) * d;
    o[2] = (S[1] * S[5] - S[2] * S[4]) * d;
    o[5] = (S[2] * S[3] - S[0] * S[5]) * d;
    o[8] = (S[0] * S[4] - S[1] * S[3]) * d;
}

/* Gain (15, 3) of a measurement of the body velocity. */
static void gain(double M[][ROW], const double *C, double R, double *K)
{
    double PH[N][3], S[9], S_inv[9];
    for (int i = 0; i < N; i++) /* P H^T = P[:, V] C */
        for (int a = 0; a < 3; a++)
            PH[i][a] = M[i][0] * C[a] + M[i][1] * C[3 + a] + M[i][2] * C[6 + a];
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++)
            S[3 * a + b] = C[a] * PH[0][b] + C[3 + a] * PH[1][b] + C[6 + a] * PH[2][b] + (a == b ? R : 0.0);
    inverse(S, S_inv);
    for (int i = 0; i < N; i++)
        for (int a = 0; a < 3; a++)
            K[3 * i + a] = PH[i][0] * S_inv[a] + PH[i][1] * S_inv[3 + a] + PH[i][2] * S_inv[6 + a];
}

static void update(State *s, const double *z, double R)
{
    double (*M)[ROW] = s->P, nu[3], K[N * 3], mean[3] = {0, 0, 0}, covariance[9], dx[N];
    double H[9]; /* C_b_n */
    int with_product = 0;
    rotate_back(nu, s->C, s->v);
    for (int a = 0; a < 3; a++)
        nu[a] = z[a] - nu[a];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            H[3 * i + j] = s->C[3 * j + i];
    double moments[3];
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        moments[i] = (j != 2 ? M[A + j][V + k] : 0.0) - (k != 2 ? M[A + k][V + j] : 0.0);
        for (int r = 0; r < 3; r++) {
            const int a = (r + 1) % 3, b = (r + 2) % 3;
            covariance[3 * i + r] = of_products(M, j, k, a, b) - of_products(M, j, k, b, a) -
                                    of_products(M, k, j, a, b) + of_products(M, k, j, b, a);
        }
    }
    const double trace = covariance[0] + covariance[4] + covariance[8];
    if (trace > PRODUCT * 3.0 * R) {
        double of_mean[3];
        with_product = 1;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                M[i][j] += covariance[3 * i + j];
        memcpy(mean, moments, sizeof mean);
        rotate(of_mean, H, mean);
        for (int a = 0; a < 3; a++)
            nu[a] += of_mean[a];
    }
    gain(M, s->C, R, K);
    for (int i = 0; i < N; i++)
        dx[i] = K[3 * i] * nu[0] + K[3 * i + 1] * nu[1] + K[3 * i + 2] * nu[2];

    /* Joseph form: B = I - K H differs from the identity in its first three columns. */
    double KH[N][3], T[N][ROW] __attribute__((aligned(32)));
    for (int i = 0; i < N; i++)
        for (int j = 0; j < 3; j++)
            KH[i][j] = K[3 * i] * H[j] + K[3 * i + 1] * H[3 + j] + K[3 * i + 2] * H[6 + j];
    for (int i = 0; i < N; i++) {
        const vec *first = (const vec *)M[0], *second = (const vec *)M[1], *third = (const vec *)M[2];
        const vec *own = (const vec *)M[i];
        vec *out = (vec *)T[i];
        for (int q = 0; q < 4; q++)
            out[q] = own[q] - KH[i][0] * first[q] - KH[i][1] * second[q] - KH[i][2] * third[q];
    }
    for (int i = 0; i < N; i++)
        for (int j = 0; j <= i; j++) {
            double total = T[i][j] - T[i][0] * KH[j][0] - T[i][1] * KH[j][1] - T[i][2] * KH[j][2];
            total += R * (K[3 * i] * K[3 * j] + K[3 * i + 1] * K[3 * j + 1] + K[3 * i + 2] * K[3 * j + 2]);
            M[i][j] = M[j][i] = total;
        }
    if (with_product) {
        double turn[9], dv[3];
        exponential(turn, 0, dx[A], dx[A + 1], 0.0);
        for (int i = 0; i < 3; i++)
            dv[i] = dx[V + i] - mean[i];
        rotate(&dx[V], turn, dv);
        turn_block(M, V, turn);
    }
    inject(s, dx);
}

/* ------------------------------------------------------------------ a mission */

/* Samples (count, 3) at a constant interval, and a ping (3,) behind every `every` of them. */
void mission(State *s, const Noise *noise, const double *f_b, const double *w_b, const double *pings,
             long count, long every, double dt, double R)
{
    for (long k = 0; k < count; k++) {
        predict(s, noise, f_b + 3 * k, w_b + 3 * k, dt);
        if (every > 0 && (k + 1) % every == 0)
            update(s, pings + 3 * ((k + 1) / every - 1), R);
    }
}

/* The same update `count` times, each from the same state. */
void updates(const State *s, const double *z, double R, long count)
{
    for (long k = 0; k < count; k++) {
        State copy = *s;
        update(&copy, z, R);
        __asm__ volatile("" : : "r"(&copy) : "memory"); /* the result is used */
    }
}
