/* The parts of run_serial(), for a program with other work to do between questions. */
#ifndef SERIAL_H
#define SERIAL_H

/* 0, or 1 with a message where the model is refused. */
int serial_start(void);
/* Waits for one question, and answers it. */
void serial_answer(void);

#endif
