// Texts of status codes: apart from the names, so that a controller that prints names alone does not hold them.
#include "status_list.hpp"

const char *aminn_status_text(int status)
{
#define AMINN_WORD(name, value, text) text "\0"
    return aminn::status_word(AMINN_STATUS_LIST(AMINN_WORD) "not a status code of this library", status);
#undef AMINN_WORD
}
