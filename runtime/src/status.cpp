// Names of status codes, version.
#include "aminn_rt.h"

const char *aminn_status_name(int status)
{
    switch (status) {
#define AMINN_CASE(name, value, text) \
    case value:                       \
        return #name;
        AMINN_STATUS_LIST(AMINN_CASE)
#undef AMINN_CASE
    default:
        return "AMINN_E_UNKNOWN";
    }
}

const char *aminn_version(void)
{
    return AMINN_VERSION_STRING;
}
