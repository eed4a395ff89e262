/** real_tanh */
static real real_tanh(real value)
{
    return {{ "tanhf" if single else "tanh" }}(value);
}

/** real_exp */
static real real_exp(real value)
{
    return {{ "expf" if single else "exp" }}(value);
}

/** real_sqrt */
static real real_sqrt(real value)
{
    return {{ "sqrtf" if single else "sqrt" }}(value);
}

/** real_pow */
static real real_pow(real base, real exponent)
{
    return {{ "powf" if single else "pow" }}(base, exponent);
}

/** real_rint */
static real real_rint(real value)
{
    return {{ "rintf" if single else "rint" }}(value);
}

/** absolute */
static real absolute(real value)
{
    return {{ "fabsf" if single else "fabs" }}(value);
}

/** logistic */
/* By a tanh, which cannot overflow. */
static real logistic(real value)
{
    return {{ 0.5|real }} + {{ 0.5|real }} * real_tanh({{ 0.5|real }} * value);
}

/** smaller */
static real smaller(real a, real b)
{
    return (a < b) ? a : b;
}

/** larger */
static real larger(real a, real b)
{
    return (a > b) ? a : b;
}

/** clip */
/* A NaN passes, to be found at the end of the step. */
static real clip(real value, real low, real high)
{
    real inside = value;

    if (value < low) {
        inside = low;
    }
    if (value > high) {
        inside = high;
    }
    return inside;
}

/** number_or_zero */
static real number_or_zero(real value)
{
    return isnan(value) ? {{ 0.0|real }} : value;
}

/** rounded */
/* What the Python controllers hand on is in single precision. */
static real rounded(real value)
{
    return (real)(float)value;
}

/** fill */
static void fill(real *to, int count, real value)
{
    for (int i = 0; i < count; i++) {
        to[i] = value;
    }
}

/** copy */
static void copy(const real *from, real *to, int count)
{
    for (int i = 0; i < count; i++) {
        to[i] = from[i];
    }
}

/** dot */
/* Four sums side by side, which a processor can add at the same time. */
static real dot(const real *a, const real *b, int count)
{
    real sum_0 = {{ 0.0|real }}, sum_1 = {{ 0.0|real }}, sum_2 = {{ 0.0|real }}, sum_3 = {{ 0.0|real }};
    int i = 0;

    for (; i + 3 < count; i += 4) {
        sum_0 += a[i] * b[i];
        sum_1 += a[i + 1] * b[i + 1];
        sum_2 += a[i + 2] * b[i + 2];
        sum_3 += a[i + 3] * b[i + 3];
    }
    for (; i < count; i++) {
        sum_0 += a[i] * b[i];
    }
    return (sum_0 + sum_1) + (sum_2 + sum_3);
}

/** product */
/* result = matrix vector; the matrix row by row. */
static void product(const real *matrix, int rows, int columns, const real *vector, real *result)
{
    for (int i = 0; i < rows; i++) {
        result[i] = dot(&matrix[i * columns], vector, columns);
    }
}

/** add_product */
/* result += matrix vector. */
static void add_product(const real *matrix, int rows, int columns, const real *vector, real *result)
{
    for (int i = 0; i < rows; i++) {
        result[i] += dot(&matrix[i * columns], vector, columns);
    }
}

/** affine */
/* result = matrix vector + bias. */
static void affine(const real *matrix, const real *bias, int rows, int columns, const real *vector, real *result)
{
    for (int i = 0; i < rows; i++) {
        result[i] = dot(&matrix[i * columns], vector, columns) + bias[i];
    }
}

/** multiply */
/* result = a b, of rows x inner and inner x columns. */
static void multiply(const real *a, const real *b, int rows, int inner, int columns, real *result)
{
    for (int i = 0; i < rows; i++) {
        for (int j = 0; j < columns; j++) {
            real sum = {{ 0.0|real }};

            for (int k = 0; k < inner; k++) {
                sum += a[i * inner + k] * b[k * columns + j];
            }
            result[i * columns + j] = sum;
        }
    }
}
