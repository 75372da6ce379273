# Installs the libraries with their headers, one component per folder (see gsutConfig.cmake.in).
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)
set(if_asked "")
if(SKBUILD AND NOT GSUT_INSTALL)  # the wheel of the Python module does not contain them
  set(if_asked EXCLUDE_FROM_ALL)
endif()
set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/gsut)
foreach(folder ${GSUT_FOLDERS})
  install(TARGETS gsut_${folder} EXPORT gsut-${folder}
    ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT ${folder} ${if_asked})
  install(EXPORT gsut-${folder} NAMESPACE gsut:: DESTINATION ${package_dir} COMPONENT ${folder}
    ${if_asked})
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/cpp/gsut/${folder} DESTINATION include/gsut
    COMPONENT ${folder} ${if_asked} FILES_MATCHING PATTERN "*.h" PATTERN "*.inc")
endforeach()
install(DIRECTORY ${PROJECT_BINARY_DIR}/generated/ DESTINATION include COMPONENT cameras ${if_asked})
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/gsutConfig.cmake.in gsutConfig.cmake
  INSTALL_DESTINATION ${package_dir})
write_basic_package_version_file(gsutConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/gsutConfig.cmake
  ${CMAKE_CURRENT_BINARY_DIR}/gsutConfigVersion.cmake DESTINATION ${package_dir} COMPONENT base
  ${if_asked})
