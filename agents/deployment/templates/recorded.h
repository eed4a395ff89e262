/* Inputs of a test from its start, and what Python makes of them. */
#define RECORDED {{ periods }}

static const double recorded_inputs[RECORDED][{{ NAME }}_INPUTS] = {
{% for row in inputs %}
    { {{- row -}} },
{% endfor %}
};

static const double recorded_outputs[RECORDED][{{ NAME }}_OUTPUTS] = {
{% for row in outputs %}
    { {{- row -}} },
{% endfor %}
};
