# Installs the libraries with their headers, one component a folder (see gsutConfig.cmake.in).
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)
set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/gsut)
foreach(folder ${GSUT_FOLDERS})
  install(TARGETS gsut_${folder} EXPORT gsut-${folder} COMPONENT ${folder}
    ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(EXPORT gsut-${folder} NAMESPACE gsut:: DESTINATION ${package_dir} COMPONENT ${folder})
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/cpp/gsut/${folder} DESTINATION include/gsut
    COMPONENT ${folder} FILES_MATCHING PATTERN "*.h" PATTERN "*.inc")
endforeach()
install(DIRECTORY ${PROJECT_BINARY_DIR}/generated/ DESTINATION include COMPONENT cameras)
configure_file(${CMAKE_CURRENT_LIST_DIR}/gsutConfig.cmake.in gsutConfig.cmake @ONLY)
write_basic_package_version_file(gsutConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/gsutConfig.cmake
  ${CMAKE_CURRENT_BINARY_DIR}/gsutConfigVersion.cmake DESTINATION ${package_dir} COMPONENT base)
