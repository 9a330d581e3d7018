// Names of status codes, version.
#include "status_list.hpp"

const char *aminn_status_name(int status)
{
#define AMINN_WORD(name, value, text) #name "\0"
    return aminn::status_word(AMINN_STATUS_LIST(AMINN_WORD) "AMINN_E_UNKNOWN", status);
#undef AMINN_WORD
}

const char *aminn_version(void)
{
    return AMINN_VERSION_STRING;
}
