{% import "blocks/signals.c" as reader with context %}
{% macro state(b) %}
{{ reader.state(b) }}{% if b.r %}
    real memory[{{ b.r }}]; /* of the law */
{% endif %}
{% endmacro %}
{% macro code(b) %}
{{ reader.code(b) }}static void {{ b.name }}_reset({{ b.type }} *s)
{
{{ reader.reset(b) }}{% if b.r %}
    fill(s->memory, {{ b.r }}, {{ 0.0|real }});
{% endif %}
}

static void {{ b.name }}_step({{ b.type }} *s, const real *y, real *action)
{
    real signals[8];
    real current;
{% if b.r %}
    real excess;
    real next[{{ b.r }}];
{% endif %}

    {{ b.name }}_read(s, y, signals);
    current = dot({{ b.name }}_D, signals, 8);
{% if b.r %}
    current += dot({{ b.name }}_C, s->memory, {{ b.r }});
    excess = clip(current, {{ -b.limit|real }}, {{ b.limit|real }}) - current;
    product({{ b.name }}_A, {{ b.r }}, {{ b.r }}, s->memory, next);
    add_product({{ b.name }}_B, {{ b.r }}, 8, signals, next);
    for (int i = 0; i < {{ b.r }}; i++) {
        s->memory[i] = next[i] + excess * {{ b.name }}_W[i]; /* anti-windup */
    }
{% endif %}
    *action = rounded(clip(number_or_zero(current / {{ b.limit|real }}), {{ -1.0|real }}, {{ 1.0|real }}));
}
{% endmacro %}
