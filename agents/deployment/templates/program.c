/* {{ title }}. See {{ name }}.h. */
#include "{{ name }}.h"

#include <math.h>
#include <stddef.h>

typedef {{ name }}_real real;

{% for helper in helpers %}
{{ helper }}
{% endfor %}
{% for block in blocks %}
/* {{ block.summary }}: constants */
{{ block.constants }}
{% endfor %}
{% for block in blocks %}
/* {{ block.summary }} */
{{ block.code }}
{% endfor %}
const char *const {{ name }}_input_names[{{ NAME }}_INPUTS] = {
{% for channel in inputs %}
    "{{ channel.name }}",
{% endfor %}
};

const char *const {{ name }}_input_units[{{ NAME }}_INPUTS] = {
{% for channel in inputs %}
    "{{ channel.unit }}",
{% endfor %}
};

const {{ name }}_real {{ name }}_input_scales[{{ NAME }}_INPUTS] = {
{% for channel in inputs %}
    {{ channel.scale|real }},
{% endfor %}
};

const char *const {{ name }}_output_names[{{ NAME }}_OUTPUTS] = {
{% for channel in outputs %}
    "{{ channel.name }}",
{% endfor %}
};

const char *const {{ name }}_output_units[{{ NAME }}_OUTPUTS] = {
{% for channel in outputs %}
    "{{ channel.unit }}",
{% endfor %}
};

const {{ name }}_real {{ name }}_output_scales[{{ NAME }}_OUTPUTS] = {
{% for channel in outputs %}
    {{ channel.scale|real }},
{% endfor %}
};

const char *const {{ name }}_provenance[{{ provenance|length }}] = {
{% for key, text in provenance.items() %}
    "{{ key }}: {{ text }}",
{% endfor %}
};

unsigned long {{ name }}_size(void)
{
    return (unsigned long)sizeof({{ name }}_t);
}

void {{ name }}_init({{ name }}_t *memory)
{
{% if blocks[-1].kind == "supervisor" %}
    supervisor_init(&memory->supervisor);
{% endif %}
    {{ name }}_reset(memory);
}

void {{ name }}_reset({{ name }}_t *memory)
{
    {{ blocks[-1].name }}_reset(&memory->{{ blocks[-1].name }});
}

int {{ name }}_step({{ name }}_t *memory, const {{ name }}_real *inputs, {{ name }}_real *outputs)
{
    int code = {{ NAME }}_OK;

{% if not accepts_any_input %}
    for (int i = 0; i < {{ NAME }}_INPUTS; i++) {
        if (!isfinite(inputs[i])) {
            code = {{ NAME }}_REFUSED;
        }
    }
    if (code != {{ NAME }}_OK) {
        for (int i = 0; i < {{ NAME }}_OUTPUTS; i++) {
            outputs[i] = {{ 0.0|real }};
        }
        return code;
    }
{% endif %}
    {{ blocks[-1].name }}_step(&memory->{{ blocks[-1].name }}, inputs, outputs);
    for (int i = 0; i < {{ NAME }}_OUTPUTS; i++) {
        if (!isfinite(outputs[i])) {
            outputs[i] = {{ 0.0|real }};
            code = {{ NAME }}_FAILED;
        }
    }
    return code;
}

int {{ name }}_step_si({{ name }}_t *memory, const {{ name }}_real *inputs, {{ name }}_real *outputs)
{
    {{ name }}_real scaled[{{ NAME }}_INPUTS];
    int code;

    for (int i = 0; i < {{ NAME }}_INPUTS; i++) {
        scaled[i] = {% if rounds_inputs %}({{ name }}_real)(float)({% endif %}inputs[i] / {{ name }}_input_scales[i]{% if rounds_inputs %}){% endif %};
    }
    code = {{ name }}_step(memory, scaled, outputs);
    for (int i = 0; i < {{ NAME }}_OUTPUTS; i++) {
        outputs[i] *= {{ name }}_output_scales[i];
    }
    return code;
}
