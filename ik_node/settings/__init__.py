"""The parameters of the package: declaration, validation, parameter files.

``schema`` defines how a parameter is declared and checked. ``groups`` declares all parameters in frozen dataclasses and
combines them in ``Settings``. ``replaced`` names what replaces the parameters of earlier versions. ``parameter_file``
reads ROS parameter files without ROS.

Data flow: YAML file, command line, recording or ROS parameters -> flat names and values -> ``Settings.with_values`` ->
the constructors and ``configure`` methods of the other packages. ``describe()`` lists the metadata, from which the node
declares its ROS parameters and ``docs/make_parameter_table.py`` writes docs/parameters.md.

A new parameter is a new field in ``groups``; afterwards run ``python docs/make_parameter_table.py``.
"""
