{% import "blocks/signals.c" as reader with context %}
{% macro state(b) %}
{{ reader.state(b) }}    real gains[4]; /* adapted, of displacement, velocity, demand, integral [-] */
    real integral; /* of the displacement error [m s] */
{% endmacro %}
{% macro code(b) %}
{{ reader.code(b) }}static void {{ b.name }}_reset({{ b.type }} *s)
{
{{ reader.reset(b) }}    fill(s->gains, 4, {{ 0.0|real }});
    s->integral = {{ 0.0|real }};
}

static void {{ b.name }}_step({{ b.type }} *s, const real *y, real *action)
{
    const real omega = {{ b.omega|real }}; /* reference model [rad/s] */
    const real zeta = {{ b.damping_ratio|real }};
    const real unit = {{ b.displacement|real }}; /* of displacements [m] */
    real signals[8];
    real regressor[4];
    real demand, error, rate, weighted, current, sum, scale, adapted;
    int is_free;

    {{ b.name }}_read(s, y, signals);
    demand = signals[7] + {{ 2.0|real }} * zeta / omega * signals[6] + signals[5] / (omega * omega);
    error = signals[7] - signals[0];
    rate = signals[6] - signals[1];
    weighted = (error + rate / (omega * zeta)) / unit;
    regressor[0] = signals[0] / unit;
    regressor[1] = signals[1] / omega / unit;
    regressor[2] = demand / unit;
    regressor[3] = {% if b.error_integral %}omega * s->integral / unit{% else %}{{ 0.0|real }}{% endif %};
    scale = {{ 1.0|real }};
{% if b.normalised %}
    scale += dot(regressor, regressor, 4);
{% endif %}
    sum = {{ 0.0|real }};
    for (int i = 0; i < 4; i++) {
        sum += (s->gains[i] + {{ b.beta|real }} * (weighted * regressor[i] / scale)) * regressor[i];
    }
    current = dot({{ b.name }}_D, signals, 8) + {{ b.gain_unit|real }} * unit * sum;
    is_free = absolute(current) <= {{ b.limit|real }}; /* adaptation waits while the valve saturates */
    for (int i = 0; i < 4; i++) {
        adapted = (is_free != 0) ? {{ b.alpha|real }} * (weighted * regressor[i] / scale) : {{ 0.0|real }};
        adapted = s->gains[i] + {{ b.period|real }} * (adapted - {{ b.leakage|real }} * s->gains[i]);
{% if b.bounded %}
        adapted = clip(adapted, {{ -b.bound|real }}, {{ b.bound|real }});
{% endif %}
        s->gains[i] = number_or_zero(adapted);
    }
    if (is_free != 0) {
        s->integral = number_or_zero(s->integral + {{ b.period|real }} * error);
    }
    *action = rounded(clip(number_or_zero(current / {{ b.limit|real }}), {{ -1.0|real }}, {{ 1.0|real }}));
}
{% endmacro %}
