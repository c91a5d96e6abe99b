from fynjax._core.compiler import refuse_wrong_sums

refuse_wrong_sums()
