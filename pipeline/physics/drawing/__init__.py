"""Drawing sources: compact cores as phase-binned stamps, far wings on a coarse grid."""
