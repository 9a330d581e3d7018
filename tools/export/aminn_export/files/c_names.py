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
    acos acosh asin asinh atan atan2 atanh cabs cacos cacosh canonicalize carg casin casinh catan catanh cbrt ccos
    ccosh ceil cexp cimag clog clog10 conj copysign cos cosh cpow cproj creal csin csinh csqrt ctan ctanh drem erf
    erfc exp exp10 exp2 expm1 fabs fdim finite floor fma fmax fmaximum fmaximum_mag fmaximum_mag_num fmaximum_num
    fmaxmag fmin fminimum fminimum_mag fminimum_mag_num fminimum_num fminmag fmod frexp fromfp fromfpx gamma
    getpayload hypot ilogb isinf isnan j0 j1 jn ldexp lgamma llogb llrint llround log log10 log1p log2 logb lrint
    lround modf nan nearbyint nextafter nextdown nexttoward nextup pow pow10 remainder remquo rint round roundeven
    scalb scalbln scalbn setpayload setpayloadsig significand sin sincos sinh sqrt tan tanh tgamma totalorder
    totalordermag trunc ufromfp ufromfpx y0 y1 yn
    """.split()
)
"""Functions of the C library that have forms for other types of numbers (sinf, sinl, sinf32x)."""

LIBRARY = frozenset(
    """
    a64l abort abs accept access acct alarm aligned_alloc alloca alphasort arc4random arc4random_buf
    arc4random_uniform asctime asprintf assert at_quick_exit atexit atof atoi atol atoll basename bcmp bcopy bind
    brk bsearch btowc bzero c16rtomb c32rtomb call_once calloc canonicalize_file_name cfgetispeed cfgetospeed
    cfmakeraw cfsetispeed cfsetospeed cfsetspeed chdir chmod chown chroot clearenv clearerr clock clock_adjtime
    clock_getcpuclockid clock_getres clock_gettime clock_nanosleep clock_settime clone close close_range closedir
    closefrom closelog confstr connect control_word copy_file_range count creat crypt ctermid ctime cuserid daemon
    data daylight difftime dirfd div dladdr dladdr1 dlclose dlerror dlinfo dlmopen dlopen dlsym dlvsym dprintf
    drand48 dup dup2 dup3 duplocale dysize eaccess ecvt endhostent endnetent endprotoent endservent endusershell
    erand48 errno euidaccess execl execle execlp execv execve execveat execvp execvpe exit explicit_bzero faccessat
    fallocate fchdir fchmod fchmodat fchown fchownat fclose fcloseall fcntl fcvt fdatasync fdopen fdopendir
    feclearexcept fedisableexcept feenableexcept fegetenv fegetexcept fegetexceptflag fegetmode fegetround
    feholdexcept feof feraiseexcept ferror fesetenv fesetexcept fesetexceptflag fesetmode fesetround fetestexcept
    fetestexceptflag feupdateenv fexecve fflush ffs ffsl ffsll fgetc fgetpos fgets fgetwc fgetws fileno flockfile
    fmemopen fopen fopencookie fork fpathconf fpclassify fprintf fputc fputs fputwc fputws fread free freeaddrinfo
    freelocale freopen fscanf fseek fseeko fsetpos fstat fstatat fsync ftell ftello ftruncate ftrylockfile
    funlockfile futimens fwide fwprintf fwrite fwscanf gcvt get_current_dir_name getaddrinfo getc getchar getcpu
    getcwd getdate getdelim getdents64 getdirentries getdomainname getdtablesize getegid getentropy getenv geteuid
    getgid getgroups gethostbyaddr gethostbyname gethostent gethostid gethostname getitimer getline getloadavg
    getlogin getnameinfo getnetbyaddr getnetbyname getnetent getopt getpagesize getpass getpeername getpgid getpgrp
    getpid getppid getprotobyname getprotobynumber getprotoent getpt getresgid getresuid getservbyname getservbyport
    getservent getsid getsockname getsockopt getsubopt gettid gettimeofday getuid getusershell getw getwc getwchar
    getwd gmtime grantpt group_member gsignal htonl htons imaxabs imaxdiv index initstate ioctl isalnum isalpha
    isascii isatty isblank iscntrl isctype isdigit isfinite isgraph isgreater isgreaterequal isless islessequal
    islessgreater islower isnormal isprint ispunct isspace isunordered isupper iswalnum iswalpha iswblank iswcntrl
    iswctype iswdigit iswgraph iswlower iswprint iswpunct iswspace iswupper iswxdigit isxdigit jmp_buf jrand48 kill
    kill_dependency killpg l64a labs lchown lcong48 ldiv link linkat linux listen llabs lldiv localeconv localtime
    lockf longjmp lrand48 lseek lstat main malloc math_errhandling mblen mbrlen mbrtoc16 mbrtoc32 mbrtowc mbsinit
    mbsnrtowcs mbsrtowcs mbstowcs mbtowc memccpy memchr memcmp memcpy memfrob memmem memmove memory_order mempcpy
    memrchr memset mkdir mkdirat mkdtemp mkfifo mkfifoat mknod mknodat mkostemp mkostemps mkstemp mkstemps mktemp
    mktime mlock mlockall mmap mprotect mrand48 msync munlock munlockall munmap name_to_handle_at nanosleep
    newlocale next nice nrand48 ntohl ntohs obstack_printf obstack_vprintf offsetof on_exit once_flag open
    open_by_handle_at open_memstream open_wmemstream openat opendir openlog optarg opterr optind optopt pathconf
    pause pclose perror pipe pipe2 poll popen pos ppoll pread prev printf profil pselect psiginfo psignal ptsname
    putc putchar putenv puts putw putwc putwchar pwrite qecvt qfcvt qgcvt qsort quick_exit raise rand random
    rawmemchr read readahead readdir readlink readlinkat realloc reallocarray realpath recv recvfrom recvmsg remove
    rename renameat renameat2 revoke rewind rewinddir rindex rmdir rpmatch sbrk scandir scandirat scanf
    secure_getenv seed48 seekdir select send sendmsg sendto setbuf setbuffer setdomainname setegid setenv seteuid
    setgid sethostent sethostid sethostname setitimer setjmp setlinebuf setlocale setlogin setlogmask setnetent
    setns setpgid setpgrp setprotoent setregid setresgid setresuid setreuid setservent setsid setsockopt setstate
    setuid setusershell setvbuf shutdown sigabbrev_np sigaction sigaddset sigaltstack sigandset sigblock sigdelset
    sigdescr_np sigemptyset sigfillset siggetmask sighold sigignore siginterrupt sigisemptyset sigismember
    sigjmp_buf siglongjmp signal signbit sigorset sigpause sigpending sigprocmask sigqueue sigrelse sigreturn sigset
    sigsetmask sigstack sigsuspend sigtimedwait sigwait sigwaitinfo sleep snprintf sockatmark socket socketpair
    splice sprintf srand srand48 srandom sscanf ssignal stat std stderr stdin stdout stpcpy stpncpy strcasecmp
    strcasestr strcat strchr strchrnul strcmp strcoll strcpy strcspn strdup strerror strerrordesc_np strerrorname_np
    strfromd strfromf strfroml strfry strftime strlen strncasecmp strncat strncmp strncpy strndup strnlen strpbrk
    strptime strrchr strsep strsignal strspn strstr strtod strtof strtoimax strtok strtol strtold strtoll strtoq
    strtoul strtoull strtoumax strtouq strverscmp strxfrm swab swprintf swscanf symlink symlinkat sync
    sync_file_range syncfs syscall sysconf syslog system sysv_signal tcdrain tcflow tcflush tcgetattr tcgetpgrp
    tcgetsid tcsendbreak tcsetattr tcsetpgrp tee telldir tempnam tgkill time timegm timelocal timer_create
    timer_delete timer_getoverrun timer_gettime timer_settime timespec_get timespec_getres timezone tmpfile tmpnam
    toascii tolower toupper towctrans towlower towupper truncate ttyname ttyslot tzset u_char u_int u_long u_quad_t
    u_short ualarm umask ungetc ungetwc unix unlink unlinkat unlockpt unsetenv unshare uselocale usleep utimensat
    utimes va_arg va_copy va_end va_list va_start valloc vasprintf vdprintf versionsort vfork vfprintf vfscanf
    vfwprintf vfwscanf vhangup vmsplice vprintf vscanf vsnprintf vsprintf vsscanf vswprintf vswscanf vsyslog
    vwprintf vwscanf wait waitid waitpid wcpcpy wcpncpy wcrtomb wcscasecmp wcscat wcschr wcschrnul wcscmp wcscoll
    wcscpy wcscspn wcsdup wcsftime wcslen wcsncasecmp wcsncat wcsncmp wcsncpy wcsnlen wcsnrtombs wcspbrk wcsrchr
    wcsrtombs wcsspn wcsstr wcstod wcstof wcstoimax wcstok wcstol wcstold wcstoll wcstombs wcstoq wcstoul wcstoull
    wcstoumax wcstouq wcswcs wcswidth wcsxfrm wctob wctomb wctrans wctype wcwidth wmemchr wmemcmp wmemcpy wmemmove
    wmempcpy wmemset wprintf write wscanf
    """.split()
)
"""Other names of C's, POSIX's and GNU's headers, and what compilers define; some have forms (pread64, rand_r)."""

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
    r"(PRI|SCN)[A-Za-z].*|(f(32|64)x?|d|f)(add|sub|mul|div|fma|sqrt)(f(32|64|128)x?|l)?": "C keeps such names",
    r"(atomic|cnd|memory_order|mtx|posix|pthread|sched|sem|thrd|tss|va)_.*": "C and POSIX keep such names",
    r"(?i)aminn(_(?!model).*)?": "it may be a name of the runtime's or of another file of the export",
    r"(?i)aminn_model_(t|check|from_blob)": "it is a name of the runtime's",
    r"(?i)con|prn|aux|nul|(com|lpt)[0-9]": "Windows keeps such names of files for devices",
    r"(?i)golden": "it is the file of the golden vectors",
}


def _is_of_the_library(name: str) -> bool:
    plain = re.sub(r"((32|64|128)x?)?(_(l|r|unlocked))?$", "", name, count=1)
    number = plain in MATHEMATICS or (plain[-1:] in ("f", "l") and plain[:-1] in MATHEMATICS)
    return number or name in LIBRARY or plain in LIBRARY


def _objection(prefix: str) -> str | None:
    """Why a C identifier cannot be a prefix; None if it can."""
    if prefix in KEYWORDS:
        return "it is a word of C or C++"
    if _is_of_the_library(prefix):
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
