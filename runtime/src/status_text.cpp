// Texts of status codes: apart from the names, so that a controller that prints names alone does not hold them.
#include "aminn_rt.h"

const char *aminn_status_text(int status)
{
    switch (status) {
#define AMINN_CASE(name, value, text) \
    case value:                       \
        return text;
        AMINN_STATUS_LIST(AMINN_CASE)
#undef AMINN_CASE
    default:
        return "not a status code of this library";
    }
}
