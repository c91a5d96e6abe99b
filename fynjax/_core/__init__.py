from fynjax._core.compiler import set_flags

set_flags()
