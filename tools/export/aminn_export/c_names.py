"""Which names a C model may have: none of the languages', the C library's, the runtime's, the export's own files."""

from __future__ import annotations

import re

from aminn_base.errors import AminnError

KEYWORDS = frozenset(
    """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char char16_t char32_t char8_t class
    co_await co_return co_yield compl complex concept const const_cast consteval constexpr constinit continue decltype
    default delete do double dynamic_cast else enum explicit export extern false final float for friend fortran goto
    if imaginary import inline int long module mutable namespace new noexcept noreturn not not_eq nullptr operator or
    or_eq override private protected public register reinterpret_cast requires restrict return short signed sizeof
    static static_assert static_cast struct switch template this thread_local throw true try typedef typeid typename
    typeof typeof_unqual union unsigned using virtual void volatile wchar_t while xor xor_eq
    """.split()
)
"""Of C up to C23 and C++ up to C++20, with what their headers make of them."""

MATHEMATICS = frozenset(
    """
    acos acosh asin asinh atan atan2 atanh cabs cacos cacosh carg casin casinh catan catanh cbrt ccos ccosh ceil cexp
    cimag clog conj copysign cos cosh cpow cproj creal csin csinh csqrt ctan ctanh erf erfc exp exp2 expm1 fabs fdim
    floor fma fmax fmin fmod frexp hypot ilogb ldexp lgamma llrint llround log log10 log1p log2 logb lrint lround modf
    nan nearbyint nextafter nexttoward pow remainder remquo rint round scalbln scalbn sin sinh sqrt tan tanh tgamma
    trunc
    """.split()
)
"""Functions of the C library that have forms for float (f) and long double (l)."""

LIBRARY = frozenset(
    """
    abort abs accept access alarm aligned_alloc alphasort asctime asprintf assert at_quick_exit atexit atof atoi atol
    atoll bind bsearch btowc c16rtomb c32rtomb call_once calloc cfgetispeed cfgetospeed cfsetispeed cfsetospeed chdir
    chmod chown clearerr clock close closedir closelog confstr connect control_word count creat ctime data daylight
    difftime dirfd div dlclose dlerror dlopen dlsym dup dup2 endhostent endnetent endprotoent endservent errno execl
    execle execlp execv execve execvp exit faccessat fchdir fchmod fchmodat fchown fchownat fclose fcntl fdatasync
    fdopendir feclearexcept fegetenv fegetexceptflag fegetround feholdexcept feof feraiseexcept ferror fesetenv
    fesetexceptflag fesetround fetestexcept feupdateenv fexecve fflush ffs fgetc fgetpos fgets fgetwc fgetws fopen
    fork fpathconf fpclassify fprintf fputc fputs fputwc fputws fread free freeaddrinfo freopen fscanf fseek fsetpos
    fstat fstatat fsync ftell ftruncate futimens fwide fwprintf fwrite fwscanf getaddrinfo getc getchar getcwd getdate
    getegid getenv geteuid getgid getgroups gethostbyaddr gethostbyname gethostent gethostid gethostname getitimer
    getlogin getnameinfo getnetbyaddr getnetbyname getnetent getopt getpeername getpgid getpgrp getpid getppid
    getprotobyname getprotobynumber getprotoent getservbyname getservbyport getservent getsid getsockname getsockopt
    gettimeofday getuid getwc getwchar gmtime htonl htons imaxabs imaxdiv ioctl isalnum isalpha isatty isblank iscntrl
    isdigit isfinite isgraph isgreater isgreaterequal isinf isless islessequal islessgreater islower isnan isnormal
    isprint ispunct isspace isunordered isupper iswalnum iswalpha iswblank iswcntrl iswctype iswdigit iswgraph
    iswlower iswprint iswpunct iswspace iswupper iswxdigit isxdigit jmp_buf kill kill_dependency killpg labs lchown
    ldiv link linkat linux listen llabs lldiv localeconv localtime lockf longjmp lseek lstat main malloc
    math_errhandling mblen mbrlen mbrtoc16 mbrtoc32 mbrtowc mbsinit mbsrtowcs mbstowcs mbtowc memchr memcmp memcpy
    memmove memory_order memset mkdir mkdirat mkfifo mkfifoat mknod mknodat mktime mlock mlockall mmap mprotect msync
    munlock munlockall munmap nanosleep next nice ntohl ntohs offsetof once_flag open openat opendir openlog optarg
    opterr optind optopt pathconf pause perror pipe poll pos pread prev printf pselect psiginfo psignal putc putchar
    puts putwc putwchar pwrite qsort quick_exit raise rand read readdir readlink readlinkat realloc recv recvfrom
    recvmsg remove rename rewind rewinddir rmdir scandir scanf seekdir select send sendmsg sendto setbuf setegid
    seteuid setgid sethostent setitimer setjmp setlocale setlogmask setnetent setpgid setpgrp setprotoent setregid
    setreuid setservent setsid setsockopt setuid setvbuf shutdown sigaction sigaddset sigaltstack sigdelset
    sigemptyset sigfillset sighold sigignore siginterrupt sigismember sigjmp_buf signal signbit sigpause sigpending
    sigprocmask sigqueue sigrelse sigset sigsuspend sigtimedwait sigwait sigwaitinfo sleep snprintf sockatmark socket
    socketpair sprintf srand sscanf stat std stderr stdin stdout strcasecmp strcat strchr strcmp strcoll strcpy
    strcspn strerror strftime strlen strncasecmp strncat strncmp strncpy strpbrk strptime strrchr strspn strstr strtod
    strtof strtoimax strtok strtol strtold strtoll strtoul strtoull strtoumax strxfrm swab swprintf swscanf symlink
    symlinkat sync sysconf syslog system tcdrain tcflow tcflush tcgetattr tcgetpgrp tcgetsid tcsendbreak tcsetattr
    tcsetpgrp telldir time timespec_get timezone tmpfile tmpnam tolower toupper towctrans towlower towupper truncate
    ttyname tzset u_char u_int u_long u_quad_t u_short umask ungetc ungetwc unix unlink unlinkat utimensat utimes
    va_arg va_copy va_end va_list va_start vasprintf vfprintf vfscanf vfwprintf vfwscanf vprintf vscanf vsnprintf
    vsprintf vsscanf vswprintf vswscanf vwprintf vwscanf wait waitid waitpid wcrtomb wcscat wcschr wcscmp wcscoll
    wcscpy wcscspn wcsftime wcslen wcsncat wcsncmp wcsncpy wcspbrk wcsrchr wcsrtombs wcsspn wcsstr wcstod wcstof
    wcstoimax wcstok wcstol wcstold wcstoll wcstombs wcstoul wcstoull wcstoumax wcsxfrm wctob wctomb wctrans wctype
    wmemchr wmemcmp wmemcpy wmemmove wmemset wprintf write wscanf
    """.split()
)
"""Other names of C's and POSIX's headers, and what compilers define."""

HEADERS = frozenset(
    """
    assert complex ctype dirent dlfcn errno fcntl fenv float inttypes iso646 limits locale malloc math memory netdb
    new poll pthread sched semaphore setjmp signal stdalign stdarg stdatomic stdbool stddef stdint stdio stdlib
    stdnoreturn string strings syslog termios tgmath threads time uchar unistd wchar wctype
    """.split()
)
"""Headers that PREFIX.h would hide from a compiler that searches the export's folder."""

_PATTERNS = {
    r"[A-Z0-9_]+": "macros are written so",
    r".*__.*|.*_": "C++ keeps names with two underscores, which it would make",
    r".*_t": "C and POSIX keep names that end in _t",
    r"(PRI|SCN)[A-Za-z].*": "C keeps such names",
    r"(atomic|cnd|memory_order|mtx|posix|pthread|sched|sem|thrd|tss|va)_.*": "C and POSIX keep such names",
    r"(?i)aminn(_(?!model).*)?": "it may be a name of the runtime's or of another file of the export",
    r"(?i)aminn_model_(t|check|from_blob)": "it is a name of the runtime's",
    r"(?i)golden": "it is the file of the golden vectors",
}


def _objection(prefix: str) -> str | None:
    """Why a C identifier cannot be a prefix; None if it can."""
    if prefix in KEYWORDS:
        return "it is a word of C or C++"
    if prefix in LIBRARY or prefix in MATHEMATICS or (prefix[-1] in "fl" and prefix[:-1] in MATHEMATICS):
        return "it is a name of the C library's"
    if prefix.lower() in HEADERS:
        return f"{prefix}.h would stand for the C library's header"
    return next((reason for pattern, reason in _PATTERNS.items() if re.fullmatch(pattern, prefix)), None)


def check_prefix(prefix: str) -> None:
    """Raises AminnError, which says what is free, unless the names that start with the prefix collide with none."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix):
        raise AminnError(f"prefix {prefix!r} is not a C identifier: letters, digits and underscores, a letter first")
    reason = _objection(prefix)
    if reason:
        raise AminnError(f"prefix {prefix!r} cannot be used: {reason}; free are aminn_model and others, say left_hand")
