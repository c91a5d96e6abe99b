from fynjax._core.compiler import multiply_in_full, set_flags

set_flags()
multiply_in_full()
