"""Data types that pass between the folders of the package: plain data without behaviour.

:mod:`.samples` are the inputs of the controller, decoded from messages but not checked; :mod:`.clock` holds the times
that come with every call. :mod:`.motion` is the desired motion that targets give to the controller, and :mod:`.step`
the result of a control step, which is published, recorded, reported and displayed. :mod:`.snapshot` captures and
restores the internal state of objects:

    JointSample, PoseSample, ... + Instant -> Controller -> Step
"""
