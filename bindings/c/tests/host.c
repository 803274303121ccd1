/* The checks of the interface on a host. */
#include <stdio.h>

#include "interface.h"

static void say(const char *text) {
    fputs(text, stdout);
}

int main(void) {
    return check_interface(say) != 0;
}
